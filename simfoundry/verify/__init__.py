"""Verification that a build is equivalent in every simulator, based on the data read back and on behavior."""
