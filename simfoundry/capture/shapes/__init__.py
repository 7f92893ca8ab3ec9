"""Fitting of one object's visible points by a closed, textured solid that stands on its support."""
