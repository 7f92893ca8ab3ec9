"""Utilities for files, processes, plug-ins and optional dependencies."""
