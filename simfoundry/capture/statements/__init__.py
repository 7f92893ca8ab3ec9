"""Names, masks, meshes and poses that people state."""
