"""Recipes: their documents, libraries, variant pools, and the documents that candidates become."""
