"""Data read back from an engine, which describes a build in the scene's terms, and the JSON form of this data.

None means that an engine does not report or store a value. Numbers are in SI units, and poses are ``[x, y, z, qw, qx,
qy, qz]``. Root links are named after the object, other links are named ``object.link``, and joints ``object.joint``.

This module requires only numpy, because it runs in each engine's own environment.
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
    """A collision shape.

    ``name`` is the collider's name in its link, or None if the engine does not store it. In that case, shapes are
    matched by order. ``kind`` is ``box``, ``sphere``, ``ellipsoid``, ``cylinder``, ``capsule``, ``cone`` or ``mesh``.
    ``bounds`` contains the minimum and maximum corners [m] of the bounding box along the link axes. ``friction`` and
    ``restitution`` are the surface's own values, before any combination rule. ``spinning`` and ``rolling`` are its
    resistances [m].
    """

    name: str | None = None
    kind: str | None = None
    bounds: Numbers | None = None
    friction: float | None = None
    restitution: float | None = None
    spinning: float | None = None
    rolling: float | None = None


# The two possible parents of a root link: ``free`` for a free link, and ``world`` for a link fixed to the world.
FREE, WORLD = "free", "world"


@dataclass(frozen=True)
class LinkReadback:
    """A link, with its pose, mass properties, parent and colliders.

    ``mass`` is in kg, ``com`` [m] is in the link frame, and ``inertia`` [kg m^2] is the row-major matrix about the
    center of mass in link axes. ``gravity_compensation`` is a share of the weight. ``held`` is the parent link,
    :data:`FREE` or :data:`WORLD`.
    """

    pose: Numbers | None = None
    mass: float | None = None
    com: Numbers | None = None
    inertia: Numbers | None = None
    held: str | None = None
    colliders: tuple[ColliderReadback, ...] | None = None
    gravity_compensation: float | None = None


@dataclass(frozen=True)
class JointReadback:
    """A movable joint.

    ``axis`` is expressed in the child link's frame. ``limits`` is empty if the engine reports no limits. A revolute
    joint without limits may be read back as continuous, and vice versa. ``position`` is an angle, a length, or the
    quaternion of a ball joint. ``follows`` is the joint that a mimic joint follows, or empty for other joints, and
    ``law`` contains its multiplier and offset. ``drive`` contains the stiffness, damping and target of the motor, and
    ``effort`` contains its maximum force. Both are empty for a joint without a motor. ``max_effort`` and
    ``max_velocity`` contain the limits of the joint itself, and are empty for a joint without these limits.
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
    max_effort: Numbers | None = None
    max_velocity: Numbers | None = None


@dataclass(frozen=True)
class WorldReadback:
    """All data that an engine reports about a world.

    ``pairs`` contains the friction coefficients of collider pairs. A pair consists of two ``link.collider`` names in
    alphabetical order, separated by a bar. ``silent`` contains the pairs of links whose collisions are disabled, in the
    same form. ``actuators`` contains the motor names. Robots are reported like objects, with links named ``robot.link``
    and the base frame ``robot``.
    """

    links: Mapping[str, LinkReadback] = field(default_factory=dict)
    joints: Mapping[str, JointReadback] = field(default_factory=dict)
    gravity: Numbers | None = None
    pairs: Mapping[str, float] | None = None
    silent: tuple[str, ...] | None = None
    actuators: tuple[str, ...] | None = None

    def to_json(self) -> dict[str, Any]:
        """Return the data as a plain mapping."""
        return asdict(self)

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> WorldReadback:
        """Restore an object from the output of :meth:`to_json`."""
        links = {name: _link(entry) for name, entry in data["links"].items()}
        joints = {name: JointReadback(**_tuples(entry)) for name, entry in data["joints"].items()}
        gravity, silent, actuators = (
            None if data.get(key) is None else tuple(data[key]) for key in ("gravity", "silent", "actuators")
        )
        return cls(links, joints, gravity, data.get("pairs"), silent, actuators)


@dataclass(frozen=True)
class Moment:
    """A sample of a simulation at a time [s], with the object poses and the joint positions [rad or m]."""

    time: float
    poses: Mapping[str, Numbers]
    joints: Mapping[str, float]

    def to_json(self) -> dict[str, Any]:
        """Return the data as a plain mapping."""
        return asdict(self)

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Moment:
        """Restore an object from the output of :meth:`to_json`."""
        return cls(data["time"], {k: tuple(v) for k, v in data["poses"].items()}, data["joints"])

    def pose(self, name: str) -> Pose:
        """Return the pose of an object in the world."""
        return pose_of(self.poses[name])


# Time step [s] for builds that do not specify one, which is small enough for all behaviors in ``verify``.
TIMESTEP = 1e-3


class Session(ABC):
    """A build loaded in an engine, in the scene's initial state. ``timestep`` [s] is 0 if it cannot be stepped."""

    timestep = TIMESTEP

    @abstractmethod
    def read(self) -> WorldReadback:
        """Return the data stored in the engine."""

    @abstractmethod
    def step(self) -> None:
        """Advance the simulation by one step."""

    @abstractmethod
    def moment(self, time: float) -> Moment:
        """Return a sample of the current state, labeled with ``time`` [s]."""

    def close(self) -> None:  # noqa: B027  # most engines release their memory with the session
        """Release engine resources that are not released with the object."""


def driven(joints: Mapping[str, JointReadback]) -> tuple[str, ...]:
    """Return the names of the joints that have a motor."""
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
    """Join two names in alphabetical order with a bar."""
    return "|".join(sorted((a, b)))


def shape_bounds(kind: str, size: Sequence[float] | Array, X_LG: Pose) -> Numbers:
    """Return the bounds of a primitive in link axes.

    ``size`` is ``x y z`` for a box, ``rx ry rz`` for an ellipsoid, ``r`` for a sphere, and ``r h`` for a cylinder, a
    capsule or a cone.
    """
    r = X_LG.rotation
    match kind:
        case "box":
            half = np.abs(r) @ (np.asarray(size, dtype=np.float64) / 2)
        case "sphere":
            half = np.full(3, float(size[0]))
        case "ellipsoid":
            half = np.sqrt(((r * np.asarray(size, dtype=np.float64)) ** 2).sum(axis=1))
        case "cone":
            tip, spread = r[:, 2] * size[1] / 2, size[0] * np.sqrt(np.maximum(0.0, 1 - r[:, 2] ** 2))
            return numbers([X_LG.p + np.minimum(-tip - spread, tip), X_LG.p + np.maximum(-tip + spread, tip)])
        case "cylinder":
            along = np.abs(r[:, 2])
            half = along * size[1] / 2 + size[0] * np.sqrt(np.maximum(0.0, 1 - along**2))
        case _:
            half = np.abs(r[:, 2]) * size[1] / 2 + size[0]
    return numbers([X_LG.p - half, X_LG.p + half])


def mesh_bounds(vertices: Array, X_LG: Pose) -> Numbers:
    """Return the bounds of an array of vertices with shape (n, 3), in link axes."""
    points = X_LG.apply(np.asarray(vertices, dtype=np.float64))
    return numbers([points.min(axis=0), points.max(axis=0)])


def _link(entry: Mapping[str, Any]) -> LinkReadback:
    parts = entry.get("colliders")
    colliders = None if parts is None else tuple(ColliderReadback(**_tuples(part)) for part in parts)
    return LinkReadback(**{**_tuples(entry), "colliders": colliders})


def _tuples(entry: Mapping[str, Any]) -> dict[str, Any]:
    return {key: tuple(value) if isinstance(value, list) else value for key, value in entry.items()}
