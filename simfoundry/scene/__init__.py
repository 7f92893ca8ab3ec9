"""The lowered scene: everything explicit, no simulator defaults left to apply."""
