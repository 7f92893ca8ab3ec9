"""Lowered scenes, in which everything is explicit and nothing depends on the defaults of a simulator."""
