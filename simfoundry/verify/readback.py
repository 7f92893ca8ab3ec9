"""The read-back of an engine: the contents of a build in the scene's terms, and its JSON form between processes.

None stands for a value that an engine does not report or does not store. Numbers are in SI units; poses are ``[x, y, z,
qw, qx, qy, qz]``. A root link has the name of the object, any other link ``object.link``; a joint is ``object.joint``.
This module needs only numpy, because it runs beside each engine in that engine's environment.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from simfoundry.geometry.frames import Array, Pose

Numbers = tuple[float, ...]


@dataclass(frozen=True)
class ColliderReadback:
    """One collision shape.

    ``name`` is the collider's name in its link, None if the engine does not store it; shapes are then matched by order.
    ``kind`` is ``box``, ``sphere``, ``cylinder``, ``capsule`` or ``mesh``. ``bounds`` are the low and high corners of
    its bounding box along the link axes [m]. ``friction`` and ``restitution`` are those of the surface, before any pair
    rule; ``spinning`` and ``rolling`` are its resistances [m].
    """

    name: str | None = None
    kind: str | None = None
    bounds: Numbers | None = None
    friction: float | None = None
    restitution: float | None = None
    spinning: float | None = None
    rolling: float | None = None


FREE, WORLD = "free", "world"
"""The two values that describe a root link: free, or fixed to the world."""


@dataclass(frozen=True)
class LinkReadback:
    """A link: ``mass`` [kg], ``com`` [m] in the link frame, ``inertia`` [kg m^2] about it in link axes, row-major.

    ``held`` is the parent link, or :data:`FREE`, or :data:`WORLD`.
    """

    pose: Numbers | None = None
    mass: float | None = None
    com: Numbers | None = None
    inertia: Numbers | None = None
    held: str | None = None
    colliders: tuple[ColliderReadback, ...] | None = None


@dataclass(frozen=True)
class JointReadback:
    """A moving joint; ``axis`` is in the child link's frame; ``limits`` is empty if the engine reports none.

    A revolute joint without limits may be read back as continuous, and vice versa. ``position`` is an angle, a length,
    or the quaternion of a ball joint. ``follows`` is the joint that it mimics, or empty, with the multiplier and offset
    in ``law``. ``drive`` is stiffness, damping and target of its motor, and ``effort`` its maximum force; both are
    empty without a motor.
    """

    type: str | None = None
    axis: Numbers | None = None
    limits: Numbers | None = None
    damping: float | None = None
    friction: float | None = None
    armature: float | None = None
    position: float | Numbers | None = None
    follows: str | None = None
    law: Numbers | None = None
    drive: Numbers | None = None
    effort: Numbers | None = None


@dataclass(frozen=True)
class WorldReadback:
    """All data that an engine reports about a world; ``pairs`` are its frictions for pairs of colliders.

    A pair is two ``link.collider`` names in alphabetical order, separated by a bar; ``silent`` are pairs of links that
    pass through each other, in the same form. ``actuators`` are the motors by name. Robots are reported like objects,
    with links ``robot.link`` and the base frame ``robot``.
    """

    links: Mapping[str, LinkReadback] = field(default_factory=dict)
    joints: Mapping[str, JointReadback] = field(default_factory=dict)
    gravity: Numbers | None = None
    pairs: Mapping[str, float] | None = None
    silent: tuple[str, ...] | None = None
    actuators: tuple[str, ...] | None = None

    def to_json(self) -> dict[str, Any]:
        """Return a plain mapping."""
        return asdict(self)

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> WorldReadback:
        """Restore the output of :meth:`to_json`."""
        links = {name: _link(entry) for name, entry in data["links"].items()}
        joints = {name: JointReadback(**_tuples(entry)) for name, entry in data["joints"].items()}
        gravity, silent, actuators = (
            None if data.get(key) is None else tuple(data[key]) for key in ("gravity", "silent", "actuators")
        )
        return cls(links, joints, gravity, data.get("pairs"), silent, actuators)


@dataclass(frozen=True)
class Moment:
    """A sample of a run at a time [s]: poses of the objects, positions of the joints [rad or m]."""

    time: float
    poses: Mapping[str, Numbers]
    joints: Mapping[str, float]

    def to_json(self) -> dict[str, Any]:
        """Return a plain mapping."""
        return asdict(self)

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Moment:
        """Restore the output of :meth:`to_json`."""
        return cls(data["time"], {k: tuple(v) for k, v in data["poses"].items()}, data["joints"])

    def pose(self, name: str) -> Pose:
        """Return the pose of an object in the world."""
        return pose_of(self.poses[name])


TIMESTEP = 1e-3
"""Time step [s] for engines whose build does not set one, small enough for all behaviors of ``verify``."""


class Session(ABC):
    """A build loaded in an engine, in the initial state of the scene; ``timestep`` [s] is 0 if it cannot be stepped."""

    timestep = TIMESTEP

    @abstractmethod
    def read(self) -> WorldReadback:
        """Return the data that the engine holds."""

    @abstractmethod
    def step(self) -> None:
        """Advance by one step."""

    @abstractmethod
    def moment(self, time: float) -> Moment:
        """Return the current sample; ``time`` [s] is only recorded."""

    def close(self) -> None:  # noqa: B027  # most engines free their memory with the session
        """Release the engine, if it does not do so with the object."""


def driven(joints: Mapping[str, JointReadback]) -> tuple[str, ...]:
    """Return the names of the joints with a motor."""
    return tuple(name for name, joint in joints.items() if joint.drive)


def numbers(values: object) -> Numbers:
    """Return a flat tuple of floats from any array-like value."""
    return tuple(float(v) for v in np.asarray(values, dtype=np.float64).ravel())


def pose_numbers(pose: Pose) -> Numbers:
    """Return a pose as seven numbers."""
    return (*numbers(pose.p), *numbers(pose.q))


def pose_of(values: Sequence[float]) -> Pose:
    """Return the pose given by seven numbers."""
    return Pose.of(values[:3], values[3:])


def pair_name(a: str, b: str) -> str:
    """Return two names in alphabetical order, separated by a bar."""
    return "|".join(sorted((a, b)))


def shape_bounds(kind: str, size: Sequence[float] | Array, X_LG: Pose) -> Numbers:
    """Return the bounds of a primitive in link axes: box ``x y z``; sphere ``r``; cylinder and capsule ``r h``."""
    r = X_LG.rotation
    match kind:
        case "box":
            half = np.abs(r) @ (np.asarray(size, dtype=np.float64) / 2)
        case "sphere":
            half = np.full(3, float(size[0]))
        case "cylinder":
            along = np.abs(r[:, 2])
            half = along * size[1] / 2 + size[0] * np.sqrt(np.maximum(0.0, 1 - along**2))
        case _:
            half = np.abs(r[:, 2]) * size[1] / 2 + size[0]
    return numbers([X_LG.p - half, X_LG.p + half])


def mesh_bounds(vertices: Array, X_LG: Pose) -> Numbers:
    """Return the bounds of vertices, shape (n, 3), in link axes."""
    points = X_LG.apply(np.asarray(vertices, dtype=np.float64))
    return numbers([points.min(axis=0), points.max(axis=0)])


def _link(entry: Mapping[str, Any]) -> LinkReadback:
    parts = entry.get("colliders")
    colliders = None if parts is None else tuple(ColliderReadback(**_tuples(part)) for part in parts)
    return LinkReadback(**{**_tuples(entry), "colliders": colliders})


def _tuples(entry: Mapping[str, Any]) -> dict[str, Any]:
    return {key: tuple(value) if isinstance(value, list) else value for key, value in entry.items()}
