"""Conversion of compiled stages, including later edits, back to the original document."""
