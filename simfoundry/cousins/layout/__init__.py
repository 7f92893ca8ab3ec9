"""Layouts of a twin: placement constraints, sampling of poses, settling and acceptance."""
