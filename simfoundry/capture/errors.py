"""What a capture can do wrong, said in words that help."""

from __future__ import annotations


class CaptureError(Exception):
    """A capture that cannot be turned into a scene: a stable ``code``, what is wrong, and what to do about it."""

    def __init__(self, code: str, message: str, hint: str) -> None:
        super().__init__(f"{message} [{code}]\n  hint: {hint}")
        self.code = code
        self.message = message
        self.hint = hint
