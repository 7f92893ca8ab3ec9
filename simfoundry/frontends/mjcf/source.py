"""Compiled MuJoCo model with the names of its elements, as input of the reader."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from simfoundry.frontends.draft import BodyDraft, JointDraft, ModelDraft
from simfoundry.geometry.frames import Pose


@dataclass(eq=False)
class MjcfSource:
    """The module mujoco, a model with its data at the first keyframe, and the resulting draft.

    ``is_own`` is True for files that SimFoundry compiled. ``owners`` contains for each body its draft, its link, and
    the pose of the link frame in the body frame; ``joints`` contains for each joint the draft of its body and its own.
    """

    mujoco: Any
    model: Any
    data: Any
    draft: ModelDraft
    is_own: bool
    owners: dict[int, tuple[BodyDraft, str, Pose]] = field(default_factory=dict)
    joints: dict[int, tuple[BodyDraft, JointDraft]] = field(default_factory=dict)

    def name(self, kind: str, number: int) -> str:
        """Return the name of an element, empty if it has none; ``kind`` is a MuJoCo object type such as `body`."""
        return self.mujoco.mj_id2name(self.model, getattr(self.mujoco.mjtObj, f"mjOBJ_{kind.upper()}"), number) or ""

    def label(self, kind: str, number: int) -> str:
        """Return the name of an element for a message, or its number."""
        name = self.name(kind, number)
        return f"`{name}`" if name else f"number {number + 1}"
