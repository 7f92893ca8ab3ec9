"""Measures of a reconstruction against the truth."""
