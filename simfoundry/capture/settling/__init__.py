"""Bringing a reconstruction to rest."""
