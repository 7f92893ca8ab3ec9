"""Checks beyond types (names, files, plausible values) and reports of the findings."""
