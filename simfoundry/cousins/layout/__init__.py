"""Layouts of a twin: placement constraints, pose sampling, settling and acceptance."""
