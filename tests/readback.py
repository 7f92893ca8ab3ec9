"""What engines hold of a scene, read by the targets' own modules and compared with it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from simfoundry.geometry.frames import Pose
from simfoundry.runtime.files import shipped
from simfoundry.runtime.plugins import import_file
from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.model import JointType, Scene
from simfoundry.verify.readback import WorldReadback, pose_of
from simfoundry.worlds.base import World
from simfoundry.worlds.mujoco_world import MujocoWorld
from simfoundry.worlds.pybullet_world import PybulletWorld

if TYPE_CHECKING:
    from pxr import Usd


def read_world(world: World) -> WorldReadback:
    """What the engine of a world holds now."""
    if isinstance(world, MujocoWorld):
        session = _module("mujoco").MujocoSession(world.model, world.data)
    else:
        assert isinstance(world, PybulletWorld)
        session = _module("pybullet").PybulletSession(world.client, world.bodies, tuple(world.scene.gravity), [])
    found: WorldReadback = session.read()
    return found


def read_stage(stage: Usd.Stage) -> WorldReadback:
    """What a stage holds."""
    found: WorldReadback = _module("usd").UsdSession(stage).read()
    return found


def _module(target: str):  # type: ignore[no-untyped-def]
    return import_file(Path(shipped("targets")) / target / "readback.py")


def poses_of(found: WorldReadback) -> dict[str, Pose]:
    """The poses of the links in the world."""
    return {name: pose_of(link.pose) for name, link in found.links.items() if link.pose is not None}


def assert_links(scene: Scene, found: WorldReadback, rel: float, pose_tolerance: float) -> None:
    """Poses, masses, centers of mass and inertias are the scene's; None is what an engine does not keep."""
    assert set(found.links) == {o.qualified(link.name) for o in scene.objects for link in o.links}
    for item in scene.objects:
        X_OL = link_poses(item)
        for link in item.links:
            held, X_WL = found.links[item.qualified(link.name)], item.X_WO @ X_OL[link.name]
            assert held.pose is not None
            assert np.linalg.norm(pose_of(held.pose).p - X_WL.p) < pose_tolerance
            assert pose_of(held.pose).angle_to(X_WL) < pose_tolerance
            if held.mass is None:  # PyBullet keeps no mass of a root that is welded to the world
                assert item.fixed and link is item.root
                continue
            assert held.com is not None and held.inertia is not None
            assert held.mass == pytest.approx(link.mass, rel=rel)
            assert np.linalg.norm(np.array(held.com) - link.com) <= rel * max(1.0, float(np.linalg.norm(link.com)))
            off = np.linalg.norm(np.array(held.inertia).reshape(3, 3) - link.inertia)
            assert off <= rel * np.linalg.norm(link.inertia)


def assert_joints(scene: Scene, found: WorldReadback, rel: float) -> None:
    """Joints that move are the scene's in what an engine tells of them."""
    still = (JointType.FIXED, JointType.FREE)
    joints = {f"{o.name}.{j.name}": j for o in scene.objects for j in o.joints if j.type not in still}
    assert set(found.joints) == set(joints)
    for name, joint in joints.items():
        held = found.joints[name]
        assert held.type == ("revolute" if joint.type is JointType.CONTINUOUS else joint.type.value)
        assert (held.axis is None) == (not joint.has_axis)
        assert held.axis is None or np.linalg.norm(np.array(held.axis) - joint.axis) < rel
        if joint.has_axis:
            assert held.limits == pytest.approx(joint.limits if joint.limits is not None else (), rel=rel)
        for quantity in ("damping", "friction", "armature"):
            told = getattr(held, quantity)
            assert told is None or told == pytest.approx(getattr(joint, quantity), rel=rel, abs=1e-9), quantity
        for limit, wanted in ((held.max_effort, joint.effort), (held.max_velocity, joint.velocity)):
            assert not limit or wanted is None or limit == pytest.approx((wanted,), rel=rel)
        mimic, drive = joint.mimic, joint.drive
        if held.law is not None:
            assert held.law == pytest.approx(() if mimic is None else (mimic.multiplier, mimic.offset), rel=rel)
            assert held.follows == ("" if mimic is None else f"{name.partition('.')[0]}.{mimic.joint}")
        if held.drive is not None:
            gains = () if drive is None else (drive.stiffness, drive.damping, drive.target)
            assert held.drive == pytest.approx(gains, rel=rel)
            limit = () if drive is None or drive.force_limit is None else (drive.force_limit,)
            assert held.effort == pytest.approx(limit, rel=rel)
