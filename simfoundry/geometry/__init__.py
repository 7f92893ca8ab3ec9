"""Measures of shapes: the only implementation of each."""
