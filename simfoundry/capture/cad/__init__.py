"""CAD libraries: folders of meshes with which objects in a capture are compared."""
