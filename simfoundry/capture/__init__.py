"""Sensors to spec: from colour, depth and intrinsics to objects with poses, sizes and names."""
