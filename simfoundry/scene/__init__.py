"""The lowered scene: everything explicit, nothing left to a simulator's guess."""
