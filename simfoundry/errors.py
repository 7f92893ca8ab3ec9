"""Errors that every layer may raise and the command line turns into a sentence."""

from __future__ import annotations


class SimfoundryError(Exception):
    """Something that cannot be done here; the message says why, and what to do about it."""


class MissingEngineError(SimfoundryError, RuntimeError):
    """A simulator that is not installed; the message says how to install it."""


class OutputError(SimfoundryError):
    """A place where nothing may be written: what lies there would be lost."""
