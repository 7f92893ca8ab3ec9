"""Lints: valid documents that will not work as intended, one module per finding, judged on the lowered scene."""
