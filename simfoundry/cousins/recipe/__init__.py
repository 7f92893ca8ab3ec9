"""Recipes: recipe documents, object libraries, variant pools, and the documents written for candidates."""
