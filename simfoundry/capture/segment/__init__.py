"""Segment a depth image into the support surface and the objects on it, and build the support graph."""
