"""What types cannot say about a document, by its kind."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from simfoundry.spec.check.checker import Checker, Use
from simfoundry.spec.diagnostics import Diagnostic
from simfoundry.spec.loaded import Loaded
from simfoundry.spec.models.base import DocumentSpec


def check(loaded: Loaded, sound: DocumentSpec | None, whole: bool, use: Use) -> list[Diagnostic]:
    """Findings of a document beyond its types; ``sound`` is its typed spec, or what of it is sound where not ``whole``.

    The documents that it uses are read with ``use`` and added to ``loaded.uses``.
    """
    if sound is None:
        return []
    c = Checker(loaded, whole, use)
    _check_of(getattr(sound, "simfoundry"))(c, sound)  # noqa: B009
    _conflicts(c, sound)
    return c.findings


def _check_of(kind: str) -> Callable[[Checker, Any], None]:
    """The check of a kind of document, loaded when it is first needed."""
    match kind:
        case "scene/1":
            from simfoundry.spec.check.scene import check_scene

            return check_scene
        case "task/1":
            from simfoundry.spec.check.task import check_task

            return check_task
        case "asset/1":
            from simfoundry.spec.check.asset import check_asset

            return check_asset
        case "capture/1":
            from simfoundry.spec.check.capture import check_capture

            return check_capture
        case "policy/1":
            from simfoundry.spec.check.policy import check_policy

            return check_policy
    from simfoundry.spec.check.cousins import check_cousins

    return check_cousins


def _conflicts(c: Checker, spec: DocumentSpec) -> None:
    for path, conflict in spec.conflicts.items():
        message = f"`{path}` is left to decide: ours {_shown(conflict.ours)}, theirs {_shown(conflict.theirs)}"
        c.add("SF209", ("conflicts", path), message, f"write the right value at `{path}`, then remove this entry")


def _shown(value: object) -> str:
    import json

    text = json.dumps(value, ensure_ascii=False)
    return "nothing" if value is None else f"`{text[:60]}{'…' if len(text) > 60 else ''}`"
