"""Errors of captures: a stable code, the fault, and a remedy."""

from __future__ import annotations


class CaptureError(Exception):
    """A capture that cannot be turned into a scene: a stable ``code``, the fault, and a hint that says what to do."""

    def __init__(self, code: str, message: str, hint: str) -> None:
        super().__init__(f"{message} [{code}]\n  hint: {hint}")
        self.code = code
        self.message = message
        self.hint = hint
