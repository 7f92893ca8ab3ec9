"""Lints that find problems in documents that are valid but will not work as intended.

Lints run on the lowered scene. Each group of findings has its own module.
"""
