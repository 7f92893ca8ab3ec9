"""The document language: typed models, YAML text, checks, and changes."""
