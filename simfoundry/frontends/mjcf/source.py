"""A compiled MuJoCo model while it is read, with the names of its elements."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from simfoundry.frontends.draft import BodyDraft, JointDraft, ModelDraft
from simfoundry.geometry.frames import Pose


@dataclass(eq=False)
class MjcfSource:
    """The module mujoco, a model and its data at the first keyframe, and the draft that is made of them.

    ``is_own`` is true for files that SimFoundry compiled. ``owners`` has by body its draft, its link, and the pose of
    the link's frame in the body's; ``joints`` has by joint the body's draft and the joint's.
    """

    mujoco: Any
    model: Any
    data: Any
    draft: ModelDraft
    is_own: bool
    owners: dict[int, tuple[BodyDraft, str, Pose]] = field(default_factory=dict)
    joints: dict[int, tuple[BodyDraft, JointDraft]] = field(default_factory=dict)

    def name(self, kind: str, number: int) -> str:
        """Return the name of an element, empty where it has none; ``kind`` is MuJoCo's, as `body`."""
        return self.mujoco.mj_id2name(self.model, getattr(self.mujoco.mjtObj, f"mjOBJ_{kind.upper()}"), number) or ""

    def label(self, kind: str, number: int) -> str:
        """Return the name of an element for a message, or its number."""
        name = self.name(kind, number)
        return f"`{name}`" if name else f"number {number + 1}"
