"""Definitions and uses of each name in a project, as exact ranges of the texts."""
