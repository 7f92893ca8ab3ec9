"""Conversion of compiled stages, including later edits, back to their documents."""
