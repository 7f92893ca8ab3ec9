"""Segmentation of a depth picture into the support and the objects on it, with the support graph."""
