"""The read-back of an engine: what it holds of a build, in the scene's terms, and as JSON between processes.

None stands for what an engine does not tell, or does not keep. Numbers are SI; poses are ``[x, y, z, qw, qx, qy, qz]``.
A link goes by the object's name where it is the root, else by ``object.link``; a joint by ``object.joint``. Only numpy
is needed here: this runs beside each engine, in whatever environment it lives.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Protocol

import numpy as np

from simfoundry.geometry.frames import Array, Pose

Numbers = tuple[float, ...]


@dataclass(frozen=True)
class ColliderReadback:
    """One collision shape.

    ``name`` is the collider's in its link, None where the engine forgets it; then shapes are told apart by their order.
    ``kind`` is ``box``, ``sphere``, ``cylinder``, ``capsule`` or ``mesh``; ``bounds`` the low and the high corner of
    the box about it along the axes of the link [m]; ``friction`` and ``restitution`` those of the surface, before any
    rule for a pair; ``spinning`` and ``rolling`` its resistance against those [m].
    """

    name: str | None = None
    kind: str | None = None
    bounds: Numbers | None = None
    friction: float | None = None
    restitution: float | None = None
    spinning: float | None = None
    rolling: float | None = None


FREE, WORLD = "free", "world"
"""What holds the root of an object."""


@dataclass(frozen=True)
class LinkReadback:
    """A link: ``mass`` [kg], ``com`` [m] in the link frame, ``inertia`` [kg m^2] about it in link axes, row by row.

    ``held`` is the link that its joint hangs it on, or :data:`FREE`, or :data:`WORLD`.
    """

    pose: Numbers | None = None
    mass: float | None = None
    com: Numbers | None = None
    inertia: Numbers | None = None
    held: str | None = None
    colliders: tuple[ColliderReadback, ...] | None = None


@dataclass(frozen=True)
class JointReadback:
    """A joint that moves; ``axis`` in the child link's frame; ``limits`` is empty where the engine says there are none.

    A revolute joint without limits may read back as continuous, and the other way round. ``position`` is an angle or
    a length, or the quaternion of a ball joint. ``follows`` is the joint that it follows, empty for none, by the
    ``law`` of multiplier and offset. ``drive`` is stiffness, damping and target of its motor, and ``effort`` the
    greatest force of that; both are empty for none.
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
    """All that an engine says about a world; ``pairs`` are the frictions that it holds for pairs of colliders.

    A pair is ``link.collider`` and ``link.collider`` in alphabetical order, with a bar between; ``silent`` are pairs of
    links that pass through each other, written the same way. ``actuators`` are the motors by name. Robots are told
    like objects: their links as ``robot.link``, the frame of their base as ``robot``.
    """

    links: Mapping[str, LinkReadback] = field(default_factory=dict)
    joints: Mapping[str, JointReadback] = field(default_factory=dict)
    gravity: Numbers | None = None
    pairs: Mapping[str, float] | None = None
    silent: tuple[str, ...] | None = None
    actuators: tuple[str, ...] | None = None

    def to_json(self) -> dict[str, Any]:
        """A plain mapping."""
        return asdict(self)

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> WorldReadback:
        """Return what :meth:`to_json` wrote."""
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
        """A plain mapping."""
        return asdict(self)

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Moment:
        """Return what :meth:`to_json` wrote."""
        return cls(data["time"], {k: tuple(v) for k, v in data["poses"].items()}, data["joints"])

    def pose(self, name: str) -> Pose:
        """The pose of an object in the world."""
        return pose_of(self.poses[name])


TIMESTEP = 1e-3
"""Seconds a step, for engines whose build does not say: small enough for each behaviour of ``verify``."""


class Session(Protocol):
    """A build in an engine, in the state that the scene describes."""

    @property
    def timestep(self) -> float:
        """Seconds a step; 0 where the engine only reads."""
        ...

    def read(self) -> WorldReadback:
        """Return what the engine holds."""
        ...

    def step(self) -> None:
        """Advance by one step."""
        ...

    def moment(self, time: float) -> Moment:
        """Return the present sample; ``time`` [s] is only written down."""
        ...

    def close(self) -> None:
        """Let go of the engine."""
        ...


def numbers(values: object) -> Numbers:
    """A tuple of floats from anything like an array, flattened."""
    return tuple(float(v) for v in np.asarray(values, dtype=np.float64).ravel())


def pose_numbers(pose: Pose) -> Numbers:
    """A pose as seven numbers."""
    return (*numbers(pose.p), *numbers(pose.q))


def pose_of(values: Sequence[float]) -> Pose:
    """The pose that seven numbers stand for."""
    return Pose.of(values[:3], values[3:])


def pair_name(a: str, b: str) -> str:
    """Two names in alphabetical order with a bar between."""
    return "|".join(sorted((a, b)))


def shape_bounds(kind: str, size: Sequence[float] | Array, X_LG: Pose) -> Numbers:
    """The box about a primitive along the link's axes: box ``x y z``; sphere ``r``; cylinder and capsule ``r h``."""
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
    """The box about vertices, shape (n, 3), along the link's axes."""
    points = X_LG.apply(np.asarray(vertices, dtype=np.float64))
    return numbers([points.min(axis=0), points.max(axis=0)])


def _link(entry: Mapping[str, Any]) -> LinkReadback:
    parts = entry.get("colliders")
    colliders = None if parts is None else tuple(ColliderReadback(**_tuples(part)) for part in parts)
    return LinkReadback(**{**_tuples(entry), "colliders": colliders})


def _tuples(entry: Mapping[str, Any]) -> dict[str, Any]:
    return {key: tuple(value) if isinstance(value, list) else value for key, value in entry.items()}
