"""Definitions, references and renames across documents."""
