"""Lowered scenes, in which everything is explicit and nothing is left to simulator defaults."""
