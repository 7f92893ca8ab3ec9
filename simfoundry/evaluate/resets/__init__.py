"""Starts of rollouts: reset grid, placement, settling, and their cache."""
