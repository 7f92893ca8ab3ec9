"""Fit solids to the visible points of objects.

The solids are closed and textured, and they stand on their supports.
"""
