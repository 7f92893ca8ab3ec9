"""Small mechanisms for behavior measurements, as lowered scenes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from simfoundry.geometry.frames import IDENTITY, Array, Pose, frozen_array, quat_from_rpy
from simfoundry.geometry.shapes import Box, Cylinder, Geometry, Mesh, Primitive, Sphere
from simfoundry.scene.model import Collider, Drive, Joint, JointType, Link, Mimic, Scene, SceneObject, Visual

# Gravitational acceleration [m/s^2], downward.
GRAVITY = 9.81

_GRAY = frozen_array([0.6, 0.6, 0.65, 1.0])
_BLUE = frozen_array([0.25, 0.45, 0.8, 1.0])


def scene_of(name: str, *objects: SceneObject) -> Scene:
    """Return a scene with standard gravity."""
    return Scene(name=name, gravity=frozen_array([0.0, 0.0, -GRAVITY]), objects=objects)


def posed(x: float, y: float, z: float, roll: float = 0.0, pitch: float = 0.0, yaw: float = 0.0) -> Pose:
    """Return a pose from a position [m] and fixed-axis angles [rad]."""
    return Pose.of([x, y, z], quat_from_rpy(roll, pitch, yaw))


def solid(
    name: str, shape: Primitive, X_WO: Pose, mass: float = 0.2, friction: float = 0.5, restitution: float = 0.0,
    fixed: bool = False,
) -> SceneObject:  # fmt: skip
    """Return an object that consists of a single primitive with uniform density, centered on the object's frame."""
    link = _link("body", mass, moments(shape, mass), np.zeros(3), shape, friction, restitution)
    return SceneObject(name, name, fixed, X_WO, (link,))


def moments(shape: Primitive, mass: float) -> Array:
    """Return the principal moments of inertia [kg m^2] of a solid box, ball or cylinder, as an array of shape (3,)."""
    match shape:
        case Box(size=size):
            x, y, z = size
            return mass / 12 * np.array([y * y + z * z, x * x + z * z, x * x + y * y])
        case Sphere(radius=r):
            return np.full(3, 0.4 * mass * r * r)
        case Cylinder(radius=r, height=h):
            side = mass * (3 * r * r + h * h) / 12
            return np.array([side, side, mass * r * r / 2])
    raise ValueError(f"unsupported shape {type(shape).__name__}")


def box(x: float, y: float, z: float) -> Box:
    """Return a box with full side lengths [m]."""
    return Box(frozen_array([x, y, z]))


def lopsided(name: str, X_WO: Pose) -> SceneObject:
    """Return a ball with an eccentric center of mass and a non-diagonal inertia."""
    turn = posed(0, 0, 0, 0.4, -0.3, 0.9).rotation
    inertia = turn @ np.diag([2e-4, 3e-4, 4e-4]) @ turn.T
    link = _link("body", 0.4, inertia, np.array([0.02, -0.01, 0.03]), Sphere(0.05))
    return SceneObject(name, name, False, X_WO, (link,))


def wedge(name: str, X_WO: Pose, friction: float = 0.5) -> SceneObject:
    """Return a wedge of 0.12 m x 0.08 m x 0.05 m that lies on its largest face.

    The wedge is a convex mesh with six vertices.
    """
    x, y, z = 0.12, 0.08, 0.05
    vertices = np.array([[0, 0, 0], [x, 0, 0], [0, y, 0], [x, y, 0], [0, 0, z], [0, y, z]]) - [x / 3, y / 2, 0.0]
    faces = [[0, 2, 1], [1, 2, 3], [0, 4, 2], [2, 4, 5], [0, 1, 4], [2, 5, 3], [1, 3, 4], [3, 5, 4]]
    mesh = Mesh(frozen_array(vertices), np.array(faces, dtype=np.int32))
    inertia = np.array([2e-4, 2.6e-4, 3.6e-4])
    link = _link("body", 0.24, inertia, np.array([0.0, 0.0, z / 3]), mesh, friction, rgba=_BLUE)
    return SceneObject(name, name, False, X_WO, (link,))


def ramps(degrees: Sequence[float], mu_box: float, mu_ramp: float, gap: float = 2e-4) -> Scene:
    """Return a scene with fixed ramps side by side along y, and a box on each ramp. Sliding boxes move toward -x."""
    objects = []
    for k, angle in enumerate(degrees):
        X_WR = posed(0.0, 0.4 * k, 1.0, pitch=-math.radians(angle))
        objects.append(solid(f"ramp{k}", box(2.4, 0.3, 0.06), X_WR, 20.0, mu_ramp, fixed=True))
        X_RB = Pose.of([0.7, 0.0, 0.03 + 0.02 + gap])
        objects.append(solid(f"box{k}", box(0.1, 0.08, 0.04), X_WR @ X_RB, 0.3, mu_box))
    return scene_of("ramps", *objects)


def jointed(
    name: str, kind: JointType, axis: Sequence[float], bob: tuple[float, Array, Array], X_WO: Pose,
    limits: tuple[float, float] | None, damping: float = 0.0, friction: float = 0.0, position: float = 0.0,
) -> SceneObject:  # fmt: skip
    """Return a mount that is fixed to the world and carries a movable bob.

    ``bob`` contains the mass, center of mass and inertia of the bob.
    """
    mass, com, inertia = bob
    mount = _link("mount", 1.0, moments(box(0.04, 0.04, 0.04), 1.0), np.zeros(3), box(0.04, 0.04, 0.04))
    moving = _link("bob", mass, inertia, com, box(0.03, 0.03, 0.03), X_LG=Pose.of(com), rgba=_BLUE)
    joint = Joint(
        "joint", kind, "mount", "bob", Pose.of([0.0, 0.0, 0.0]), frozen_array(axis), limits,
        damping=damping, friction=friction, position=position,
    )  # fmt: skip
    return SceneObject(name, name, True, X_WO, (mount, moving), (joint,))


def pendulum(amplitude: float, damping: float = 0.0) -> SceneObject:
    """Return a 0.5 kg physical pendulum, 0.4 m below a hinge along y and deflected by ``amplitude`` [rad]."""
    mass, length = 0.5, 0.4
    inertia = moments(box(0.05, 0.07, 0.09), mass)
    bob = (mass, np.array([0.0, 0.0, -length]), inertia)
    return jointed("pendulum", JointType.REVOLUTE, [0, 1, 0], bob, posed(0.1, -0.2, 1.0, yaw=0.7), (-1.5, 1.5),
                   damping=damping, position=amplitude)  # fmt: skip


def pendulum_constants() -> tuple[float, float]:
    """Return the hinge inertia [kg m^2] and restoring torque per radian [N m/rad] of :func:`pendulum`."""
    mass, length = 0.5, 0.4
    about_com = float(moments(box(0.05, 0.07, 0.09), mass)[1])
    return about_com + mass * length**2, mass * GRAVITY * length


# The mass [kg], center of mass [m] and principal moments of inertia [kg m^2] of the weight on a slider.
_WEIGHT = (1.0, np.array([0.0, 0.0, -0.1]), moments(box(0.05, 0.05, 0.05), 1.0))


def slider(damping: float = 0.0, friction: float = 0.0, travel: float = 6.0, drive: Drive | None = None) -> SceneObject:
    """Return a vertical 1 kg slider that can fall by ``travel`` [m] from its upper end. Its axis points down."""
    item = jointed("slider", JointType.PRISMATIC, [0, 0, -1], _WEIGHT, posed(0.1, 0.2, 10.0, yaw=0.4), (-0.2, travel),
                   damping=damping, friction=friction)  # fmt: skip
    return replace(item, joints=(replace(item.joints[0], drive=drive),))


def geared(multiplier: float) -> SceneObject:
    """Return two weights that slide down in parallel. The ``follower`` moves ``multiplier`` times as far."""
    X_WO = posed(0, 0, 10.0, yaw=0.4)
    one = jointed("gear", JointType.PRISMATIC, [0, 0, -1], _WEIGHT, X_WO, (-0.2, 3.0), damping=5.0)
    (mount, moving), (joint,) = one.links, one.joints
    side = Pose.of([0.2, 0.0, 0.0])
    leader = replace(joint, name="leader")
    law = Mimic("leader", multiplier)
    follower = replace(joint, name="follower", child="other", X_PC=side, limits=(-0.4, 6.0), mimic=law, damping=0.0)
    return replace(one, links=(mount, moving, replace(moving, name="other")), joints=(leader, follower))


def _link(
    name: str, mass: float, inertia: Array, com: Array, shape: Geometry, friction: float = 0.5,
    restitution: float = 0.0, X_LG: Pose = IDENTITY, rgba: Array = _GRAY,
) -> Link:  # fmt: skip
    """Return a link with a single shape. ``inertia`` contains the principal moments or the whole tensor."""
    tensor = np.diag(inertia) if np.ndim(inertia) == 1 else (inertia + inertia.T) / 2
    visual, collider = Visual("shape", shape, rgba, X_LG), Collider("shape", shape, friction, restitution, X_LG)
    return Link(name, mass, frozen_array(com), frozen_array(tensor), (visual,), (collider,))
