"""Typed documents: scenes, assets, tasks, recipes, captures and policies."""
