"""Strict YAML in and out, with the position of every value and every comment kept."""
