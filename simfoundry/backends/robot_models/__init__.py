"""Robot models for all backends, which are read by MuJoCo, converted to articulated objects, and written as URDF."""
