"""Starts of rollouts: cells of the reset grid, placement, settling, and their cache."""
