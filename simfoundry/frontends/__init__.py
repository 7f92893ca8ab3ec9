"""Files of other formats to specs: URDF, MJCF, USD, and the scenes and tasks of the authors' release."""
