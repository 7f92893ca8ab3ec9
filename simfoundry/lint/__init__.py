"""Lints that find problems in valid documents that will not work as intended.

Lints are evaluated on the lowered scene, with one module for each group of findings.
"""
