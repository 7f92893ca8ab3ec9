"""Stages of a reconstruction, whose results are plain files that later runs reuse."""
