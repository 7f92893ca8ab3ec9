"""Verification that a build means the same in every simulator, based on the data read back and on behavior."""
