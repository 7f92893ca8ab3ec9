"""Reconstruct scene specs from sensor data: color, depth and intrinsics in; objects with names, poses, sizes out."""
