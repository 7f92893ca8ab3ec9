"""The lowered scene, which is the input to all backends. Backends do not make any modeling decisions of their own.

All quantities are in SI units, and all arrays are float64 and read-only. The world is right-handed with z up,
quaternions are wxyz, and ``X_AB`` is the pose of B in A. Sizes are full extents, never half extents, and cylinders and
capsules are aligned with their local z axis. Camera frames use OpenCV axes (x right, y down, z forward).
"""

from __future__ import annotations

import copyreg
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from simfoundry.assets.panorama import Panorama as Panorama
from simfoundry.geometry.frames import IDENTITY, Array, Pose, principal_inertia
from simfoundry.geometry.shapes import Geometry
from simfoundry.scene.attachments import Actuator, NativeAttributes, Options, Sensor, Site
from simfoundry.scene.source import Source as Source

if TYPE_CHECKING:
    from simfoundry.scene.random_values import RandomValue
    from simfoundry.scene.robot import Robot
    from simfoundry.splats.gaussians import GaussianSplat


def _read_only(mapping: Mapping[str, Any]) -> MappingProxyType[str, Any]:
    """Return a read-only view of a mapping."""
    return MappingProxyType(mapping)


# Scenes and states contain read-only mappings, which Python cannot pickle or copy by default.
copyreg.pickle(MappingProxyType, lambda mapping: (_read_only, (dict(mapping),)))


@dataclass(frozen=True, eq=False)
class Visual:
    """A geometry that is visible to cameras, with its pose in the link.

    ``rgba`` is the color in [0, 1], shape (4,), by which any texture of the geometry is multiplied.
    """

    name: str
    geometry: Geometry
    rgba: Array
    X_LG: Pose = IDENTITY


@dataclass(frozen=True, eq=False)
class Collider:
    """A collider, which is a primitive or a *convex* mesh, with its pose in the link.

    Attributes:
        friction: The Coulomb coefficient of the surface. A contact uses the geometric mean of both coefficients
            (:func:`pair_friction`).
        restitution: The restitution in [0, 1]. A contact uses the geometric mean of both values.
        torsional_friction: The maximum torque that resists spinning, divided by the normal force [m]. A contact uses
            the larger of the two values.
        rolling_friction: The maximum torque that resists rolling, divided by the normal force [m]. A contact uses the
            larger of the two values.
        material: The name of the surface material, or empty if the spec does not specify one.
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
    """A rigid body that belongs to an object.

    Attributes:
        mass: The mass [kg].
        com: The center of mass in the link frame [m], shape (3,).
        inertia: The inertia about the center of mass [kg m^2], expressed in link axes as a symmetric positive definite
            matrix, shape (3, 3).
        collision_error: The maximum distance [m] of the colliders from the shapes that they approximate.
        gravity_compensation: The share of the weight that is compensated, in [0, 1].
    """

    name: str
    mass: float
    com: Array
    inertia: Array
    visuals: tuple[Visual, ...]
    colliders: tuple[Collider, ...]
    collision_error: float = 0.0
    gravity_compensation: float = 0.0

    @cached_property
    def principal(self) -> tuple[Array, Array]:
        """The principal moments and axes of the inertia; see :func:`principal_inertia`."""
        return principal_inertia(self.inertia)


class JointType(StrEnum):
    """The type of motion between a child link and its parent."""

    FIXED = "fixed"
    REVOLUTE = "revolute"
    PRISMATIC = "prismatic"
    CONTINUOUS = "continuous"
    BALL = "ball"
    FREE = "free"


@dataclass(frozen=True)
class Mimic:
    """A coupling to another ``joint`` in the same object.

    The position of the coupled joint is ``multiplier * position + offset``, with the ``position`` of that joint.
    """

    joint: str
    multiplier: float = 1.0
    offset: float = 0.0

    def position(self, leader: float) -> float:
        """Return the position of the follower [rad or m] when its leader is at ``leader`` [rad or m]."""
        return self.multiplier * leader + self.offset


@dataclass(frozen=True)
class Drive:
    """A joint motor that applies ``stiffness * (target - position) - damping * velocity``, up to ``force_limit``.

    Units: ``stiffness`` [N m/rad or N/m], ``damping`` [N m s/rad or N s/m], ``target`` [rad or m], ``force_limit`` [N m
    or N], which is None if the force is unlimited. ``actuator`` is the name of the actuator that the drive stands for.
    """

    stiffness: float
    damping: float
    target: float = 0.0
    force_limit: float | None = None
    actuator: str = ""


# The name of a joint limit.
ClosedEnd = Literal["lower", "upper"]


@dataclass(frozen=True, eq=False)
class Joint:
    """A joint between two links of one object.

    A free joint does not constrain its child, a separate body whose pose is relative to the parent. Joints with the
    same child have one axis each and act in order; only the first of them has an ``X_PC``.

    Attributes:
        X_PC: The pose of the child link frame in the parent link frame at position zero.
        axis: The axis through the child's origin, a unit vector in the child frame, shape (3,).
        limits: The limits of the position [rad or m], or None for an unlimited joint.
        damping: The damping [N m s/rad or N s/m].
        friction: The Coulomb friction torque or force [N m or N].
        armature: The armature [kg m^2 or kg].
        position: The initial position of a single-axis joint [rad or m].
        motion: The initial state of a ball or free joint: the pose of the child frame relative to its pose at position
            zero.
        closed: The limit at which the joint counts as closed. If None, it is closed at zero or the nearest limit to it.
        effort: The maximum force of all actuators, including the drive [N m or N], or None if it is unlimited.
        velocity: The maximum speed [rad/s or m/s], or None if it is unlimited.
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
    effort: float | None = None
    velocity: float | None = None

    @property
    def closed_position(self) -> float:
        """The closed position [rad or m]. By default, it is zero or the limit nearest to zero."""
        low, high = self.limits or (0.0, 0.0)
        return {"lower": low, "upper": high, None: min(max(0.0, low), high)}[self.closed]

    @property
    def has_axis(self) -> bool:
        """True if the joint rotates about or slides along a single axis, so that its state is a single number."""
        return self.type in (JointType.REVOLUTE, JointType.PRISMATIC, JointType.CONTINUOUS)


@dataclass(frozen=True, eq=False)
class SceneObject:
    """A named object, which is either a single link or a tree of links and joints whose first link is the root.

    Attributes:
        fixed: True if the object is welded to the world. All other objects have a free root.
        X_WO: The pose of the root link's frame in the world.
        links: The links in topological order (parents come first).
        no_contact: The pairs of links whose contacts are disabled, in addition to links connected by joints.
        labels: The semantic labels, by default the category.
        variant: The name of the selected variant, or empty.
        variants: All other variants, which are complete objects with the same name.
        native: What only MJCF knows of the object's elements.
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
    sites: tuple[Site, ...] = ()
    actuators: tuple[Actuator, ...] = ()
    sensors: tuple[Sensor, ...] = ()
    native: NativeAttributes = field(default_factory=NativeAttributes)

    @property
    def semantics(self) -> tuple[str, ...]:
        """The semantic labels, or the category if there are no labels."""
        return self.labels or ((self.category,) if self.category else ())

    @property
    def root(self) -> Link:
        """The link whose frame is the object's frame."""
        return self.links[0]

    @cached_property
    def joints_above(self) -> dict[str, tuple[Joint, ...]]:
        """The joints between each link and its parent, in order from the parent on. The root link has no entry."""
        found: dict[str, tuple[Joint, ...]] = {}
        for joint in self.joints:
            found[joint.child] = (*found.get(joint.child, ()), joint)
        return found

    def qualified(self, link_or_joint: str) -> str:
        """Return the qualified name of a link or joint: ``object.name``, or only ``object`` for the root link."""
        return self.name if link_or_joint == self.root.name else f"{self.name}.{link_or_joint}"


@dataclass(frozen=True)
class Camera:
    """A pinhole camera with image ``width`` x ``height`` [px], intrinsics [px], and pose ``X_WC`` (OpenCV axes)."""

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
    """A camera mounted on a link, with its pose in the frame of that link as ``camera.X_WC``.

    ``carrier`` is the name of a robot or an object, and ``link`` names one of its frames or links, or is empty for the
    base or root.
    """

    carrier: str
    link: str
    camera: Camera


class LightType(StrEnum):
    """The type of a light."""

    DISTANT = "distant"
    POINT = "point"
    DOME = "dome"


@dataclass(frozen=True, eq=False)
class Light:
    """A light that shines along -z of its frame ``X_WL`` (distant), from its origin (point), or from all sides (dome).

    ``intensity`` is relative: at an intensity of 1, a white surface that faces the light is fully lit. ``rgb`` is in
    [0, 1], shape (3,). The radiance of a dome with a ``panorama`` is that of its pixels, times the intensity and the
    color.
    """

    name: str
    type: LightType
    intensity: float
    rgb: Array
    X_WL: Pose
    panorama: Panorama | None = None


@dataclass(frozen=True, eq=False)
class Background:
    """The visual surroundings of a scene, without collisions: visuals in a frame ``X_WB``, or a splat of Gaussians."""

    X_WB: Pose
    visuals: tuple[Visual, ...] = ()
    splat: GaussianSplat | None = None


@dataclass(frozen=True)
class Relation:
    """A relation that the spec states between objects or joints (``object.joint``), such as ``OnTop(cup, desk)``."""

    predicate: str
    args: tuple[str, ...]

    def __str__(self) -> str:
        return f"{self.predicate}({', '.join(self.args)})"


@dataclass(frozen=True)
class LeftOut:
    """A part of the spec that is missing from every target, with its path and the reason.

    ``X_WB`` is the base pose if the part is a robot.
    """

    path: str
    reason: str
    X_WB: Pose | None = None


@dataclass(frozen=True, eq=False)
class Scene:
    """A lowered scene, in which world poses, inertias, convex parts and materials are all explicit.

    Attributes:
        left_out: The parts of the spec that could not be lowered. Every target reports them as lost.
        no_contact: The pairs of links in different objects whose contacts are disabled, by qualified name.
        source: The document, for targets that embed it.
        native: What only MJCF knows of the scene, by section, or None if MJCF is written in the usual way.
        viewer: The frame that defines left, right, front and behind: x points away from the viewer, and y to the left.
            If None, the world axes are used.
        random_values: The values that a recipe draws at random, if the scene is the twin of one.
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
    options: Options = field(default_factory=Options)
    native: Mapping[str, Any] | None = None
    random_values: tuple[RandomValue, ...] = ()

    @cached_property
    def by_name(self) -> dict[str, SceneObject]:
        """The objects in the scene, keyed by name."""
        return {item.name: item for item in self.objects}

    def object(self, name: str) -> SceneObject:
        """Return the object called ``name``. The KeyError for an unknown name lists the available names."""
        if name in self.by_name:
            return self.by_name[name]
        raise KeyError(f"no object {name!r}; available objects: {', '.join(o.name for o in self.objects)}")

    def robot(self, name: str) -> Robot:
        """Return the robot called ``name``. The KeyError for an unknown name lists the available names."""
        for item in self.robots:
            if item.name == name:
                return item
        raise KeyError(f"no robot {name!r}; available robots: {', '.join(r.name for r in self.robots) or 'none'}")


def pair_friction(a: float, b: float) -> float:
    """Return the Coulomb coefficient of a contact, which is the geometric mean of the coefficients of both surfaces."""
    return float(np.sqrt(a * b))


def pair_resistance(a: float, b: float) -> float:
    """Return the torsional or rolling friction [m] of a contact: the larger value, as one soft surface is enough."""
    return max(a, b)
