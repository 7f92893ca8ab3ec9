"""Robots for every backend: read by MuJoCo, as an object of links and joints, and as URDF."""
