"""Line by line differences between two texts."""

from __future__ import annotations


def unified_diff(before: str, after: str, old: str, new: str, context: int = 3) -> str:
    """Return a unified diff of two texts, with the names ``old`` and ``new`` in its header.

    ``context`` is the number of lines around each change.
    """
    import difflib

    lines = difflib.unified_diff(before.splitlines(keepends=True), after.splitlines(keepends=True), old, new, n=context)
    return "".join(line if line.endswith("\n") else f"{line}\n\\ No newline at end of file\n" for line in lines)
