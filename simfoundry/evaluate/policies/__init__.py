"""Policies: what is asked for actions, near or over a wire."""
