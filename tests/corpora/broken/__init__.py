"""Meshes and URDFs that are broken in two hundred ways, each made from a sound one with a seed."""
