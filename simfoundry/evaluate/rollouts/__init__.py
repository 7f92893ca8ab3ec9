"""Rollouts: control, observations, progress towards the goal, and videos."""
