"""The protocol of a world, which lets predicates, tasks and checks run in any simulator."""

from __future__ import annotations

from abc import ABC, abstractmethod
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
"""A color image: sRGB, shape (h, w, 3)."""

CONTACT_GAP = 1e-3
"""Maximum gap between surfaces in contact [m], for any contact margin of the engine."""


@dataclass(frozen=True, eq=False)
class Contact:
    """One contact point between two objects.

    ``depth`` [m] is positive for penetration and negative for a gap, which is at most :data:`CONTACT_GAP`. ``normal``
    is the unit vector from ``a`` toward ``b`` and ``position`` [m] the contact point, both in the world, shape (3,).
    """

    a: str
    b: str
    depth: float
    normal: Array
    position: Array


class Judging(ABC):
    """Evaluation of predicates in the current state of a world."""

    scene: Scene

    def judge(self, condition: Any) -> Verdict:
        """Evaluate a condition, such as ``"OnTop(cup, desk)"``, in the current state."""
        return self._judge(condition, self.state())

    @abstractmethod
    def state(self) -> SceneState:
        """Return the current state."""

    @cached_property
    def _judge(self) -> Judge:
        from simfoundry.predicates import Judge

        return Judge(self.scene)


class World(Protocol):
    """A simulator that holds one scene. Use it as a context manager, or call :meth:`close`."""

    scene: Scene

    @property
    def timestep(self) -> float:
        """Time step [s]."""
        ...

    def reset(self, state: SceneState | None = None) -> None:
        """Set ``state`` with zero velocities; without one, the state that the scene describes.

        Values that ``state`` omits are those of the scene; its velocities are ignored. Robots hold their positions.
        Raises a KeyError for names that are not in the scene.
        """
        ...

    def step(self, n: int = 1) -> None:
        """Advance by ``n`` time steps."""
        ...

    def halt(self) -> None:
        """Set all velocities to zero; poses and positions are unchanged."""
        ...

    def state(self) -> SceneState:
        """Return the poses and speeds of all objects and the positions of all joints, including robots."""
        ...

    def judge(self, condition: Any) -> Verdict:
        """Evaluate a condition, such as ``"OnTop(cup, desk)"``, in the current state."""
        ...

    def contacts(self) -> list[Contact]:
        """Return the current contacts between different objects and robots."""
        ...

    def robot(self, name: str) -> WorldRobot:
        """Return the robot called ``name``; raise a KeyError with the valid names if there is none."""
        ...

    def render(self, camera: str, width: int, height: int) -> Image:
        """Render a camera of the scene, including robots: sRGB, uint8, shape (height, width, 3).

        The camera image is scaled uniformly and cropped about the center if the aspect ratio differs. The state is
        unchanged. Raises a KeyError with the valid names for an unknown camera, and a RenderError if rendering is not
        available.
        """
        ...

    def trouble(self) -> str:
        """Return the reason why the simulation since the last reset is invalid; empty if it is valid."""
        ...

    def close(self) -> None:
        """Release the simulator."""
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
    """Complete ``state`` with the scene's own values; raise a KeyError for names that the scene lacks.

    A mimic joint is at the position given by its leader, unless ``state`` contains it.
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
    """Return the position [rad or m] of a mimic joint from that of the first leader in its chain."""
    if joint.mimic is None:
        return joints[f"{owner}.{joint.name}"]
    return joint.mimic.position(_led(owner, by_name[joint.mimic.joint], by_name, joints))


def _check_known(kind: str, given: Mapping[str, object], known: Mapping[str, object]) -> None:
    unknown = sorted(set(given) - set(known))
    if unknown:
        raise KeyError(f"no {kind} {unknown[0]!r} in this scene; there are: {', '.join(known) or 'none'}")
