"""Line by line differences between two texts."""

from __future__ import annotations


def unified_diff(before: str, after: str, old: str, new: str) -> str:
    """Return a unified diff of two texts, with the names ``old`` and ``new`` in its header."""
    import difflib

    lines = difflib.unified_diff(before.splitlines(keepends=True), after.splitlines(keepends=True), old, new)
    return "".join(line if line.endswith("\n") else f"{line}\n\\ No newline at end of file\n" for line in lines)
