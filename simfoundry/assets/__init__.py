"""Mesh readers, mass properties, and convex collision geometry."""
