"""Errors that every layer may raise and the command line turns into a sentence."""

from __future__ import annotations


class MissingEngineError(RuntimeError):
    """A simulator that is not installed; the message says how to install it."""
