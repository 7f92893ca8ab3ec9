"""Errors that any layer can raise and that the command line reports as a single sentence."""

from __future__ import annotations


class SimfoundryError(Exception):
    """An operation could not be completed; the message explains why and what to do about it."""


class MissingEngineError(SimfoundryError, RuntimeError):
    """A required simulator is not installed; the message explains how to install it."""


class OutputError(SimfoundryError):
    """An output was not written because it would have replaced a file that must be kept."""
