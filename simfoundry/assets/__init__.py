"""Meshes: reading them, what they weigh, and the convex parts that touch."""
