"""Robots in compiled files: read back as robots of a scene rather than as objects with links."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from simfoundry.frontends.draft import RobotDraft
from simfoundry.frontends.errors import ImportRefusedError
from simfoundry.geometry.frames import Pose
from simfoundry.spec.models.robot import RobotSpec


def robot_draft(path: Path, name: str, words: Mapping[str, Any], X_WB: Pose) -> RobotDraft:
    """Return a robot with the fields that differ from its model; raises :class:`ImportRefusedError`."""
    try:
        spec = RobotSpec.model_validate(words)
    except ValidationError as error:
        reason = error.errors()[0]["msg"]
        raise ImportRefusedError(path, f"robot `{name}` is not as compiled files have it: {reason}") from None
    known = spec.known()
    if known is None or not isinstance(spec.model, str):
        raise ImportRefusedError(path, f"robot `{name}` is of a kind that is not known: {spec.model!r}")
    usual = {"joints": dict(known.home), "reach": known.reach, "opening": known.opening}
    given = spec.model_dump(include=set(usual), exclude_none=True)
    changed = {field: value for field, value in given.items() if value != usual[field] and value != "home"}
    return RobotDraft(name, spec.model, X_WB, changed)
