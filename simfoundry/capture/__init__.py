"""Reconstruct scene specs from color and depth images."""
