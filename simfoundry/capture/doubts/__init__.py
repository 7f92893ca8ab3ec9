"""Faults of images and of their segmentation that make a reconstruction doubtful."""
