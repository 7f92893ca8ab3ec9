"""Completion of keys, names, values and files."""
