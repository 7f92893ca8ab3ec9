"""Rollouts, including control, observations, progress toward the goal, and videos."""
