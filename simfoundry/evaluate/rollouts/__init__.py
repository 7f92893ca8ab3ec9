"""Rollouts: control, observations, progress towards the goal, videos."""
