"""Evaluation of tasks in simulated worlds: resets, policies, rollouts and statistics."""
