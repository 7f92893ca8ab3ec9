"""Adapters to models that are not ours: each behind one small module, loaded when it is asked for."""
