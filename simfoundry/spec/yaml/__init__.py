"""Strict YAML reader and writer that preserve comments and the position of every value."""
