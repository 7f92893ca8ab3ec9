"""Checks beyond types: names, files and plausible values; and how findings are reported."""
