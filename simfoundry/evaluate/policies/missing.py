"""Imports of packages that only remote policies need."""

from __future__ import annotations

import importlib
from types import ModuleType

from simfoundry.evaluate.policies.base import PolicyError
from simfoundry.runtime.extras import install_line


def needed(module: str, what: str, install: str = f"install with `{install_line('policies')}`") -> ModuleType:
    """Import an optional module; raises :class:`PolicyError` with the install command if it is missing."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        absent = getattr(error, "name", None) or module
        raise PolicyError(f"{what} needs the package `{absent.partition('.')[0]}`; {install}") from None
