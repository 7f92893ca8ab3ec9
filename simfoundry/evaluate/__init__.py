"""Evaluation of policies on tasks in simulated worlds: resets, policies, rollouts and statistics."""
