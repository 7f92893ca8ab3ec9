"""Rendering of scenes without a display."""
