"""Measurement and evaluation of predicates.

This package contains the bodies and states of a scene, the terms of predicates with their margins, and the judge.
"""
