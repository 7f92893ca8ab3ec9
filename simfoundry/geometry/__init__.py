"""Geometric measures of shapes, each implemented once."""
