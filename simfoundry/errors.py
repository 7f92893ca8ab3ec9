"""Errors that any layer can raise and that the command line reports as a single sentence."""

from __future__ import annotations

import copyreg
from typing import Any


class PicklableError(Exception):
    """An error that can be pickled even if its constructor takes more than a message."""

    def __reduce__(self) -> tuple[Any, ...]:
        return copyreg.__newobj__, (type(self), *self.args), vars(self)  # type: ignore[attr-defined]


class SimfoundryError(PicklableError):
    """An operation could not be completed; the message explains why and what to do about it."""


class MissingEngineError(SimfoundryError, RuntimeError):
    """A required simulator is not installed; the message explains how to install it."""


class OutputError(SimfoundryError):
    """An output was not written because it would have replaced a file that must be kept."""
