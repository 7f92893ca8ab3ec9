"""Fit a closed, textured solid that stands on its support to the visible points of an object."""
