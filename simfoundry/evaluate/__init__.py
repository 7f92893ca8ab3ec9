"""Evaluation of policies on tasks in simulated worlds, with resets, policies, rollouts and statistics."""
