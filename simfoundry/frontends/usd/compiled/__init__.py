"""Converts compiled stages, including later edits, back to their documents."""
