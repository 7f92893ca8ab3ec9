"""The lowered scene: the input of every backend, which makes no decisions of its own.

Conventions: SI units; right-handed world, z up; quaternions wxyz; ``X_AB`` is the pose of B in A; full extents, never
half extents; cylinders and capsules along their local z; camera frames are OpenCV's (x right, y down, z forward). Every
array is float64 and read-only.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from simfoundry.assets.splat import Gaussians
from simfoundry.geometry.frames import IDENTITY, Array, Pose, frozen_array
from simfoundry.geometry.shapes import Geometry

if TYPE_CHECKING:
    from simfoundry.scene.robot import Robot


@dataclass(frozen=True, eq=False)
class Visual:
    """A visual: a geometry posed in its link and visible to cameras, with a color ``rgba`` in [0, 1], shape (4,).

    The texture of a mesh is multiplied by ``rgba``.
    """

    name: str
    geometry: Geometry
    rgba: Array
    X_LG: Pose = IDENTITY


@dataclass(frozen=True, eq=False)
class Collider:
    """A collider: a primitive or a *convex* mesh posed in its link.

    ``friction`` is the Coulomb coefficient of the surface; a pair slides at the geometric mean of its two
    (:func:`pair_friction`). ``restitution`` in [0, 1] combines the same way. ``torsional_friction`` and
    ``rolling_friction`` [m] are the maximum torques against spinning and rolling, divided by the normal force; a pair
    uses the larger of its two. ``material`` names the material of the surface; it is empty if the spec gives none.
    """

    name: str
    geometry: Geometry
    friction: float
    restitution: float
    X_LG: Pose = IDENTITY
    torsional_friction: float = 0.0
    rolling_friction: float = 0.0
    material: str = ""


@dataclass(frozen=True, eq=False)
class Link:
    """A rigid body of an object.

    ``mass`` [kg]; ``com`` [m] in the link frame, shape (3,); ``inertia`` [kg m^2] about the center of mass in link
    axes, shape (3, 3), symmetric positive definite. ``collision_error`` [m] is the maximum distance between the surface
    of its colliders and the shapes that they approximate; 0 if they are exact.
    """

    name: str
    mass: float
    com: Array
    inertia: Array
    visuals: tuple[Visual, ...]
    colliders: tuple[Collider, ...]
    collision_error: float = 0.0

    @cached_property
    def principal(self) -> tuple[Array, Array]:
        """Principal moments and axes of its inertia, see :func:`principal_inertia`."""
        return principal_inertia(self.inertia)


class JointType(StrEnum):
    """The kind of motion between a child link and its parent."""

    FIXED = "fixed"
    REVOLUTE = "revolute"
    PRISMATIC = "prismatic"
    CONTINUOUS = "continuous"
    BALL = "ball"
    FREE = "free"


@dataclass(frozen=True)
class Mimic:
    """Coupling to ``joint`` of the same object: the position is ``multiplier`` times that joint's plus ``offset``."""

    joint: str
    multiplier: float = 1.0
    offset: float = 0.0

    def position(self, leader: float) -> float:
        """Position of the follower [rad or m] when its leader is at ``leader`` [rad or m]."""
        return self.multiplier * leader + self.offset


@dataclass(frozen=True)
class Drive:
    """A motor in a joint: ``stiffness * (target - position) - damping * velocity``, at most ``force_limit``.

    ``stiffness`` [N m/rad or N/m], ``damping`` [N m s/rad or N s/m], ``target`` [rad or m]; ``force_limit`` [N m or N]
    is None if unlimited.
    """

    stiffness: float
    damping: float
    target: float = 0.0
    force_limit: float | None = None


ClosedEnd = Literal["lower", "upper"]
"""Name of one of a joint's limits."""


@dataclass(frozen=True, eq=False)
class Joint:
    """A joint between two links of one object.

    ``X_PC`` is the pose of the child link's frame in the parent's at position zero; the joint acts at the child's
    origin along ``axis`` (unit, child frame, shape (3,)). ``limits`` [rad or m] is None for an unlimited joint;
    ``damping`` [N m s/rad or N s/m]; ``friction`` is the Coulomb friction torque or force [N m or N]; ``armature`` [kg
    m^2 or kg]; ``position`` [rad or m] is the initial state of a joint with one axis. The initial state of a ball or
    free joint is ``motion``: the pose of the child's frame relative to its frame at position zero. A free joint
    constrains nothing: its child is a separate body, posed relative to the parent. ``closed`` is the limit at which the
    joint counts as closed; None means zero, or the limit nearest to zero.
    """

    name: str
    type: JointType
    parent: str
    child: str
    X_PC: Pose
    axis: Array
    limits: tuple[float, float] | None = None
    damping: float = 0.0
    friction: float = 0.0
    armature: float = 0.0
    position: float = 0.0
    motion: Pose = IDENTITY
    mimic: Mimic | None = None
    drive: Drive | None = None
    closed: ClosedEnd | None = None

    @property
    def closed_position(self) -> float:
        """Closed position [rad or m]: the limit that ``closed`` names, else zero or the limit nearest to zero."""
        low, high = self.limits or (0.0, 0.0)
        if self.closed is not None:
            return low if self.closed == "lower" else high
        return min(max(0.0, low), high)

    @property
    def has_axis(self) -> bool:
        """True if its state is one number: it rotates about its axis or slides along it."""
        return self.type in (JointType.REVOLUTE, JointType.PRISMATIC, JointType.CONTINUOUS)


@dataclass(frozen=True, eq=False)
class SceneObject:
    """A named object: one link, or a tree of links and joints whose first link is the root.

    ``X_WO`` is the pose of the root link's frame in the world. A ``fixed`` object is welded to the world; any other has
    a free root. Links are in topological order: a parent comes before its children. ``no_contact`` are pairs of links
    without contacts, in addition to those connected by joints.

    ``labels`` are its semantic labels, by default its category. ``variant`` names the selected variant, empty if it has
    none; ``variants`` are all the others, whole objects of the same name.
    """

    name: str
    category: str
    fixed: bool
    X_WO: Pose
    links: tuple[Link, ...]
    joints: tuple[Joint, ...] = ()
    no_contact: tuple[tuple[str, str], ...] = ()
    labels: tuple[str, ...] = ()
    variant: str = ""
    variants: tuple[SceneObject, ...] = ()

    @property
    def semantics(self) -> tuple[str, ...]:
        """Semantic labels, or the category if there are none."""
        return self.labels or ((self.category,) if self.category else ())

    @property
    def root(self) -> Link:
        """Link whose frame is the object's frame."""
        return self.links[0]

    @cached_property
    def joint_above(self) -> dict[str, Joint]:
        """Joint between each link and its parent, by the link's name; the root has none."""
        return {joint.child: joint for joint in self.joints}

    def qualified(self, link_or_joint: str) -> str:
        """Name in a flat target: the object's own name for its root link, else ``object.link``."""
        return self.name if link_or_joint == self.root.name else f"{self.name}.{link_or_joint}"


@dataclass(frozen=True)
class Camera:
    """A pinhole camera: image ``width`` x ``height`` [px], intrinsics [px], pose ``X_WC`` (OpenCV axes)."""

    name: str
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    X_WC: Pose


@dataclass(frozen=True)
class MountedCamera:
    """A camera mounted on a link: ``camera.X_WC`` is its pose in that link's frame.

    ``carrier`` is a robot or an object; ``link`` one of its frames or links, empty for its base or root.
    """

    carrier: str
    link: str
    camera: Camera


class LightType(StrEnum):
    """The kind of a light."""

    DISTANT = "distant"
    POINT = "point"
    DOME = "dome"


@dataclass(frozen=True, eq=False)
class Light:
    """A light; it shines along -z of its frame ``X_WL`` (distant), from its origin (point) or from everywhere (dome).

    ``intensity`` is relative: 1 lights a white surface that faces the light fully; ``rgb`` in [0, 1], shape (3,).
    """

    name: str
    type: LightType
    intensity: float
    rgb: Array
    X_WL: Pose


Splat = Gaussians
"""Visual-only 3D Gaussians, under a name that backends can import: they read scenes and not assets."""


@dataclass(frozen=True, eq=False)
class Background:
    """Visual surroundings of a scene without collisions: visuals posed in a frame ``X_WB``, or a splat of Gaussians."""

    X_WB: Pose
    visuals: tuple[Visual, ...] = ()
    splat: Splat | None = None


@dataclass(frozen=True)
class Relation:
    """A relation stated by the spec, such as ``OnTop(cup, desk)``; an argument is ``object`` or ``object.joint``."""

    predicate: str
    args: tuple[str, ...]

    def __str__(self) -> str:
        return f"{self.predicate}({', '.join(self.args)})"


@dataclass(frozen=True)
class LeftOut:
    """A part of the spec, by its path, that no target receives, and the reason; ``X_WB`` is the base of a robot."""

    path: str
    reason: str
    X_WB: Pose | None = None


@dataclass(frozen=True, eq=False)
class Scene:
    """A lowered scene: world poses, inertias, convex parts and materials are all explicit.

    ``left_out`` lists parts of the spec that could not be lowered; every target reports them as lost. ``no_contact``
    are pairs of links of different objects, by qualified name, without contacts. ``source`` is the document itself, for
    targets that embed it. ``viewer`` is the frame that defines left, right, front and behind: x points away from the
    viewer and y to its left; None for the world axes.
    """

    name: str
    gravity: Array
    objects: tuple[SceneObject, ...]
    cameras: tuple[Camera, ...] = ()
    lights: tuple[Light, ...] = ()
    relations: tuple[Relation, ...] = field(default=())
    left_out: tuple[LeftOut, ...] = ()
    robots: tuple[Robot, ...] = ()
    mounted: tuple[MountedCamera, ...] = ()
    background: Background | None = None
    no_contact: tuple[tuple[str, str], ...] = ()
    source: Source | None = None
    viewer: Pose | None = None

    @cached_property
    def by_name(self) -> dict[str, SceneObject]:
        """Objects by name."""
        return {item.name: item for item in self.objects}

    def object(self, name: str) -> SceneObject:
        """Return the object called ``name``; the KeyError for an unknown name lists the known ones."""
        if name in self.by_name:
            return self.by_name[name]
        raise KeyError(f"no object {name!r}; there are: {', '.join(o.name for o in self.objects)}")

    def robot(self, name: str) -> Robot:
        """Return the robot called ``name``; the KeyError for an unknown name lists the known ones."""
        for item in self.robots:
            if item.name == name:
                return item
        raise KeyError(f"no robot {name!r}; there are: {', '.join(r.name for r in self.robots) or 'none'}")


def pair_friction(a: float, b: float) -> float:
    """Coulomb coefficient of a contact between two surfaces: the geometric mean."""
    return float(np.sqrt(a * b))


def pair_resistance(a: float, b: float) -> float:
    """Torsional or rolling friction [m] of a contact between two surfaces: the larger, as one soft surface suffices."""
    return max(a, b)


def principal_inertia(inertia: Array) -> tuple[Array, Array]:
    """Principal moments and axes of a symmetric inertia: ``I = R diag(moments) R^T``.

    Returns moments [kg m^2], shape (3,), and the wxyz quaternion of R, shape (4,). An inertia that is diagonal already
    keeps its axes, so that symmetric bodies are not turned by rounding.
    """
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = inertia.tolist()
    if max(abs(xy), abs(xz), abs(yz)) <= 1e-12 * (xx + yy + zz):
        return frozen_array((xx, yy, zz)), IDENTITY.q
    moments, axes = np.linalg.eigh(inertia)
    for k in range(3):  # the sign of an eigenvector is arbitrary: make its largest entry positive
        if axes[np.argmax(np.abs(axes[:, k])), k] < 0:
            axes[:, k] = -axes[:, k]
    if np.linalg.det(axes) < 0:
        axes[:, 2] = -axes[:, 2]
    return frozen_array(moments), Pose.from_matrix(axes).q


@dataclass(frozen=True)
class Source:
    """The document from which a scene was lowered.

    It is opaque to backends, which may store it but must not base decisions on it. ``kind`` is that of the document
    (``scene/1``), ``file`` is its path in its project, with ``/``. ``data`` is its plain data in canonical order,
    including everything that it extends: mappings, tuples, texts, numbers.
    """

    kind: str
    file: str
    data: Mapping[str, Any]

    @classmethod
    def of(cls, file: str, data: Mapping[str, Any]) -> Source:
        """Freeze the data of a document."""
        return cls(str(data["simfoundry"]), file, MappingProxyType(dict(data)))

    @property
    def digest(self) -> str:
        """SHA-256 of the data, in hex: equal documents have equal digests."""
        return hashlib.sha256(json.dumps(dict(self.data), ensure_ascii=False).encode()).hexdigest()
