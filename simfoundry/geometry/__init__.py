"""Geometric measurements on shapes, each of which is implemented only once."""
