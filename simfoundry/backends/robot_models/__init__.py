"""Robot models for all backends: read by MuJoCo, converted to an object of links and joints, and written as URDF."""
