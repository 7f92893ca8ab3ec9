"""Run the checks beyond types for each kind of document."""

from __future__ import annotations

from importlib import import_module

from simfoundry.spec.check.checker import Checker, Use
from simfoundry.spec.diagnostics import Diagnostic
from simfoundry.spec.loaded import Loaded
from simfoundry.spec.models.base import DocumentSpec


def check(loaded: Loaded, sound: DocumentSpec | None, whole: bool, use: Use) -> list[Diagnostic]:
    """Check a document beyond types; ``sound`` is its typed spec, or only the valid part of it unless ``whole``.

    Documents that it uses are read with ``use`` and added to ``loaded.uses``.
    """
    if sound is None:
        return []
    c = Checker(loaded, whole, use)
    name = str(getattr(sound, "simfoundry")).partition("/")[0]  # noqa: B009
    getattr(import_module(f"{__package__}.{name}"), f"check_{name}")(c, sound)
    _conflicts(c, sound)
    return c.findings


def _conflicts(c: Checker, spec: DocumentSpec) -> None:
    for path, conflict in spec.conflicts.items():
        message = f"`{path}` is an open conflict: ours {_shown(conflict.ours)}, theirs {_shown(conflict.theirs)}"
        c.add("SF209", ("conflicts", path), message, f"write the right value at `{path}`, then remove this entry")


def _shown(value: object) -> str:
    import json

    text = json.dumps(value, ensure_ascii=False)
    return "nothing" if value is None else f"`{text[:60]}{'…' if len(text) > 60 else ''}`"
