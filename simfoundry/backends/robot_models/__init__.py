"""Robot models for all backends: they are read by MuJoCo, converted to articulated objects, and written as URDF."""
