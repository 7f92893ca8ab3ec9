"""Recipes, along with object libraries, variant pools, and the documents that are written for candidates."""
