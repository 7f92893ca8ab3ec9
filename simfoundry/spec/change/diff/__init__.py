"""Differences between two documents, as data and as text."""
