"""Packages that only remote policies need."""

from __future__ import annotations

import importlib
from types import ModuleType

from simfoundry.evaluate.policies.base import PolicyError
from simfoundry.runtime.extras import install_line


def needed(module: str, what: str, install: str = f"install with `{install_line('policies')}`") -> ModuleType:
    """A module that may be absent; raises :class:`PolicyError` with what to do."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        absent = getattr(error, "name", None) or module
        raise PolicyError(f"{what} needs the package `{absent.partition('.')[0]}`; {install}") from None
