"""Verification that a build has the same meaning in every simulator: its read-back data and its behavior."""
