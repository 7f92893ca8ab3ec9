"""Utilities for files, processes and optional packages, used by all other packages."""
