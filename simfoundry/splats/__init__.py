"""Gaussian splats: their values, the formats of their files, their alignment, and images of them."""
