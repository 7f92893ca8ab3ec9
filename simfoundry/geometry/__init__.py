"""Geometric measurements on shapes, each implemented only once."""
