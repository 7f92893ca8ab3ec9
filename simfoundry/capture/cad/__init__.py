"""CAD libraries: folders of meshes that objects in a capture may be."""
