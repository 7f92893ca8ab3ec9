"""Objects with every kind of joint, built by hand: mimics, drives, ball and free joints, pairs without contact."""

from __future__ import annotations

import dataclasses

import numpy as np

from simfoundry.geometry.frames import IDENTITY, Array, Pose, frozen_array
from simfoundry.geometry.shapes import Cylinder, Primitive, Sphere
from simfoundry.scene.model import Collider, Drive, Joint, JointType, Link, Mimic, Scene, SceneObject, Visual
from tests.scenes import box, pose, primitive_inertia, rgba, scene_of, skewed_inertia, solid

Z = frozen_array([0.0, 0.0, 1.0])


def unit(x: float, y: float, z: float) -> Array:
    axis = np.array([x, y, z])
    return frozen_array(axis / np.linalg.norm(axis))


def part(name: str, shape: Primitive, X_LG: Pose, mass: float, friction: float = 0.5) -> Link:
    """A link of one primitive whose mass properties are its own, away from the link's frame."""
    turned = X_LG.rotation @ primitive_inertia(shape, mass) @ X_LG.rotation.T
    inertia = frozen_array((turned + turned.T) / 2)
    seen = (Visual("shape", shape, rgba(0.5, 0.6, 0.7), X_LG),)
    return Link(name, mass, X_LG.p, inertia, seen, (Collider("shape", shape, friction, 0.0, X_LG),))


def gripper(drive: Drive | None = None, X_WO: Pose | None = None) -> SceneObject:
    """A fixed palm with two fingers that slide apart; the right one follows the left, which a motor may pull."""
    palm = part("palm", box(0.12, 0.04, 0.02), pose(0.003, 0.0, 0.0, 0.1), 0.6)
    left = part("left", box(0.01, 0.02, 0.05), pose(0.0, 0.004, 0.04), 0.05)
    right = part("right", box(0.01, 0.02, 0.06), pose(0.0, 0.002, 0.045), 0.07)
    slide = Joint("left_slide", JointType.PRISMATIC, "palm", "left", pose(-0.01, 0, 0.015, 0.0, 0.0, 0.2),
                  unit(-1, 0.2, 0.1), limits=(0.0, 0.04), damping=2.0, position=0.01, drive=drive)  # fmt: skip
    follow = Joint("right_slide", JointType.PRISMATIC, "palm", "right", pose(0.01, 0, 0.015, 0.0, 0.0, -0.1),
                   unit(1, 0.1, 0), limits=(0.0, 0.04), position=0.02 - 0.5 * 0.01,
                   mimic=Mimic("left_slide", -0.5, 0.02))  # fmt: skip
    where = pose(0.4, -0.2, 0.7, 0.3, -0.5, 1.1) if X_WO is None else X_WO
    return SceneObject("gripper", "gripper", True, where, (palm, left, right), (slide, follow))


def pendulum(motion: Pose, damping: float = 0.0, friction: float = 0.0, armature: float = 0.0) -> SceneObject:
    """A ball of 0.2 kg on a rod without mass, 0.4 m below a ball joint whose frame is turned away from the post's."""
    post = part("post", box(0.05, 0.05, 0.02), IDENTITY, 1.0)
    bob = part("bob", Sphere(0.03), pose(0.0, 0.0, -0.4), 0.2)
    X_PC = pose(0.02, -0.01, -0.03)
    swing = Joint("swing", JointType.BALL, "post", "bob", X_PC, Z, damping=damping, friction=friction,
                  armature=armature, motion=motion)  # fmt: skip
    return SceneObject("pendulum", "pendulum", True, pose(-0.6, 0.2, 1.5), (post, bob), (swing,))


def pot(fixed: bool = False) -> SceneObject:
    """A pot with a welded handle and a lid that nothing holds; on that a flap, which carries a knob on a ball joint."""
    bodies = (
        part("body", Cylinder(0.1, 0.08), pose(0.01, 0.0, 0.04), 0.8),
        part("grip", box(0.08, 0.02, 0.02), pose(0.04, 0.0, 0.0, 0.3), 0.1),
        part("lid", Cylinder(0.1, 0.01), pose(0.002, 0.003, 0.0), 0.3),
        part("flap", box(0.05, 0.05, 0.006), pose(0.03, 0.0, 0.01), 0.05),
        part("knob", Sphere(0.012), pose(0.0, 0.001, 0.02), 0.03),
    )
    joints = (
        Joint("weld", JointType.FIXED, "body", "grip", pose(0.11, 0, 0.06, 0.0, 0.1, 0.2), Z),
        Joint("rests", JointType.FREE, "body", "lid", pose(0.0, 0.0, 0.09, 0.0, 0.0, 0.3), Z,
              motion=pose(0.02, -0.03, 0.1, 0.2, -0.1, 0.7)),
        Joint("hinge", JointType.REVOLUTE, "lid", "flap", pose(0.02, 0.01, 0.02, 0.0, 0.1, 1.0), unit(0.1, 1, 0.2),
              limits=(-1.2, 0.4), damping=0.02, friction=0.01, armature=0.001, position=-0.3),
        Joint("swivel", JointType.BALL, "flap", "knob", pose(0.03, 0.01, 0.02, 0.4, 0.1, 0.2), Z,
              damping=0.001, armature=0.0002, motion=pose(0, 0, 0, 0.5, -0.4, 0.3)),
    )  # fmt: skip
    return SceneObject("pot", "pot", fixed, pose(0.2, 0.5, 0.3, 0.1, -0.2, 0.9), bodies, joints)


def chain(
    count: int = 3, gap: float = 0.0, X_WO: Pose | None = None, no_contact: tuple[tuple[str, str], ...] = ()
) -> SceneObject:
    """Boxes of 10 cm in a row, each sliding along x against the one before it, ``gap`` [m] apart."""
    links = tuple(part(f"box_{k}", box(0.1, 0.1, 0.1), IDENTITY, 0.5) for k in range(count))
    joints = tuple(
        Joint(f"slide_{k}", JointType.PRISMATIC, f"box_{k}", f"box_{k + 1}", pose(0.1 + gap, 0, 0),
              unit(1, 0, 0), limits=(-1.0, 1.0))
        for k in range(count - 1)
    )  # fmt: skip
    X_WO = pose(0, 0, 1) if X_WO is None else X_WO
    return SceneObject("chain", "chain", True, X_WO, links, joints, no_contact=no_contact)


def rough(item: SceneObject, torsional: float = 0.0, rolling: float = 0.0) -> SceneObject:
    """The object with resistance against spinning and rolling on all its surfaces [m]."""
    links = tuple(
        dataclasses.replace(link, colliders=tuple(
            dataclasses.replace(c, torsional_friction=torsional, rolling_friction=rolling) for c in link.colliders
        ))
        for link in item.links
    )  # fmt: skip
    return dataclasses.replace(item, links=links)


def mechanisms() -> Scene:
    """All of them in one scene, with drives, a pair without contact and one ball that rolls badly."""
    spring = Drive(stiffness=120.0, damping=6.0, target=0.03, force_limit=25.0)
    brake = Drive(stiffness=0.0, damping=0.05)
    item = pot()
    braked = tuple(dataclasses.replace(j, drive=brake) if j.name == "hinge" else j for j in item.joints)
    skew = Link("post", 1.0, frozen_array([0.01, 0.0, 0.02]), skewed_inertia(2e-3, 3e-3, 4e-3, 0.3, 0.2, 0.1), (), ())
    swing = pendulum(pose(0, 0, 0, 0.3, -0.2, 0.5), damping=0.01, armature=0.001)
    swing = dataclasses.replace(swing, fixed=False, links=(skew, *swing.links[1:]))
    return dataclasses.replace(
        scene_of(
            gripper(spring),
            swing,
            dataclasses.replace(item, joints=braked, no_contact=(("grip", "lid"),)),
            rough(solid("ball", Sphere(0.04), pose(0.9, 0.1, 0.4, 0.1, 0.2, 0.3), friction=0.3), 0.004, 0.002),
            solid("table", box(1.0, 0.8, 0.05), pose(0.9, 0.1, 0.1, 0.02, 0.03, 0.4), friction=0.6, fixed=True),
            name="mechanisms",
        ),
        no_contact=(("ball", "gripper.left"), ("pot.lid", "table")),
    )
