"""Rollouts: control, observations, progress toward the goal, and videos."""
