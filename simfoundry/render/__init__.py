"""Headless rendering of scenes."""
