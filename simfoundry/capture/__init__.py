"""Sensors to spec: from color, depth and intrinsics to objects with poses, sizes and names."""
