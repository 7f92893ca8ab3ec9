"""The protocol of a world: what every simulator offers, so that predicates, tasks and checks run on any of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from types import TracebackType
from typing import TYPE_CHECKING, Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from simfoundry.geometry.frames import Array
from simfoundry.scene.model import Joint, Scene
from simfoundry.scene.state import SceneState
from simfoundry.worlds.robot import WorldRobot

if TYPE_CHECKING:
    from simfoundry.predicates import Judge, Verdict

Image = NDArray[np.uint8]
"""A colour picture: sRGB, shape (h, w, 3)."""

CONTACT_GAP = 1e-3
"""Surfaces further apart than this [m] are not in contact, whatever margin an engine keeps."""


@dataclass(frozen=True, eq=False)
class Contact:
    """One point where two objects touch.

    ``depth`` [m] is positive when they interpenetrate and negative for a gap, at most :data:`CONTACT_GAP`; ``normal``
    is the unit vector from ``a`` towards ``b`` and ``position`` [m] the point, both in the world, shape (3,).
    """

    a: str
    b: str
    depth: float
    normal: Array
    position: Array


class Judging:
    """The judge of a world: predicates on the state that it is in, as on any other state of its scene."""

    scene: Scene

    def judge(self, condition: Any) -> Verdict:
        """Judge a condition, as ``"OnTop(cup, desk)"``, in the present state."""
        return self._judge(condition, self.state())

    def state(self) -> SceneState:
        """Return the present state."""
        raise NotImplementedError

    @cached_property
    def _judge(self) -> Judge:
        from simfoundry.predicates import Judge

        return Judge(self.scene)


class World(Protocol):
    """A simulator that holds one scene. Use it as a context manager, or call :meth:`close`."""

    scene: Scene

    @property
    def timestep(self) -> float:
        """Seconds a step."""
        ...

    def reset(self, state: SceneState | None = None) -> None:
        """Go to ``state``, at rest; without one, to the state that the scene describes.

        What ``state`` does not mention is as the scene describes it; its speeds are not taken up. Robots hold where
        they are put. A KeyError names what is not in the scene.
        """
        ...

    def step(self, n: int = 1) -> None:
        """Advance ``n`` steps."""
        ...

    def halt(self) -> None:
        """Set every velocity to zero; poses and positions stay."""
        ...

    def state(self) -> SceneState:
        """Poses and speeds of all objects and positions of all joints, those of robots included, now."""
        ...

    def judge(self, condition: Any) -> Verdict:
        """Judge a condition, as ``"OnTop(cup, desk)"``, in the present state."""
        ...

    def contacts(self) -> list[Contact]:
        """Contacts between different objects and robots, now."""
        ...

    def robot(self, name: str) -> WorldRobot:
        """The robot called ``name``; a KeyError lists the names there are."""
        ...

    def render(self, camera: str, width: int, height: int) -> Image:
        """Render what a camera of the scene sees now, robots included: sRGB, uint8, shape (height, width, 3).

        The camera's picture is scaled evenly, and cut at the middle where the shape is another. Nothing moves by it. A
        KeyError lists the cameras there are; a RenderError says what is missing to draw.
        """
        ...

    def trouble(self) -> str:
        """Return why the simulation can no longer be trusted since the last reset; empty while it can."""
        ...

    def close(self) -> None:
        """Let go of the simulator."""
        ...

    def __enter__(self) -> Self:
        """Return itself."""
        ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close."""
        ...


def complete_state(scene: Scene, state: SceneState | None) -> SceneState:
    """``state`` with the scene's own values for what it does not mention; a KeyError names what the scene lacks.

    A joint that follows another is where that leads it, unless ``state`` says where it is.
    """
    initial = SceneState.initial(scene)
    if state is None:
        return initial
    _check_known("object", state.poses, initial.poses)
    _check_known("joint", state.joints, initial.joints)
    _check_known("ball or free joint", state.motions, initial.motions)
    joints = {**initial.joints, **state.joints}
    for item in scene.objects:
        by_name = {joint.name: joint for joint in item.joints}
        for joint in item.joints:
            name = f"{item.name}.{joint.name}"
            if joint.mimic is not None and name not in state.joints:
                joints[name] = _led(item.name, joint, by_name, joints)
    motions = {**initial.motions, **state.motions}
    return SceneState.of({**initial.poses, **state.poses}, joints, motions, state.robots)


def _led(owner: str, joint: Joint, by_name: Mapping[str, Joint], joints: Mapping[str, float]) -> float:
    """Position [rad or m] of a joint from that of the one at the head of those that it follows."""
    if joint.mimic is None:
        return joints[f"{owner}.{joint.name}"]
    return joint.mimic.position(_led(owner, by_name[joint.mimic.joint], by_name, joints))


def _check_known(kind: str, given: Mapping[str, object], known: Mapping[str, object]) -> None:
    unknown = sorted(set(given) - set(known))
    if unknown:
        raise KeyError(f"no {kind} {unknown[0]!r} in this scene; there are: {', '.join(known) or 'none'}")
