"""Joints of objects from two captures, in which one part has moved."""
