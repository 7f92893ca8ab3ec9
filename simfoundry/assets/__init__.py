"""Meshes: readers, mass properties, and convex collision geometry."""
