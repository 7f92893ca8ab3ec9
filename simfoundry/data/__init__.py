"""Demonstrations: successful rollouts that are recorded, verified by replay, and read for datasets."""
