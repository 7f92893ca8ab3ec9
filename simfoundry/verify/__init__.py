"""Verification that a build is equivalent in every simulator, based on the read-back data and on behavior."""
