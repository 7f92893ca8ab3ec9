"""Bodies, joints and excluded pairs of a stage."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from simfoundry.backends.usd import compile_usd
from simfoundry.backends.usd.bodies import joint_frame
from simfoundry.geometry.frames import frozen_array
from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.model import (
    JointType,
    Scene,
)
from simfoundry.scene.state import SceneState
from simfoundry.verify.readback import pose_of
from tests.backends.stage_kinematics import poses_by_joints, read_back_state
from tests.backends.usd_stages import links_of, validation_errors, written
from tests.mechanisms import gripper, mechanisms, pot
from tests.readback import assert_joints, assert_links, read_stage
from tests.scenes import cabinet, scene_of

if TYPE_CHECKING:
    from pxr import Usd


def test_links_and_joints_read_back(compiled: tuple[Scene, Usd.Stage]) -> None:
    scene, stage = compiled
    found = read_stage(stage)
    assert list(found.links) == [name for name, _, _ in links_of(scene)]
    assert_links(scene, found, 1e-6, 1e-10)
    assert_joints(scene, found, 1e-6)
    for name, item, k in links_of(scene):
        frictions = [c.friction for c in found.links[name].colliders or ()]
        assert frictions == pytest.approx([c.friction for c in item.links[k].colliders], rel=1e-6)


def test_state_and_joint_frames_agree_with_kinematics(compiled: tuple[Scene, Usd.Stage]) -> None:
    scene, stage = compiled
    state, initial, by_joints = read_back_state(stage), SceneState.initial(scene), poses_by_joints(stage)
    assert dict(state.joints) == pytest.approx(dict(initial.joints), rel=1e-6)
    assert set(state.motions) == set(initial.motions)
    for name, motion in initial.motions.items():
        np.testing.assert_allclose(state.motions[name].matrix, motion.matrix, rtol=0, atol=2e-6)
    assert list(state.poses) == list(initial.poses)
    for name, item, k in links_of(scene):
        carried = {j.child for j in item.joints if j.type is not JointType.FREE} | (
            {item.root.name} if item.fixed else set()
        )
        if not item.joints or item.links[k].name not in carried:
            continue
        X_WL = item.X_WO @ link_poses(item)[item.links[k].name]
        np.testing.assert_allclose(by_joints.pop(name).matrix, X_WL.matrix, rtol=0, atol=2e-6)
    assert not by_joints


@pytest.mark.parametrize("axis", [[1, 0, 0], [0, -1, 0], [0, 0, -1], [0.6, -0.64, 0.48], [-0.1, -0.2, -0.97]])
def test_joint_frame_turns_a_coordinate_axis_onto_the_axis(axis: list[float]) -> None:
    unit = frozen_array(np.array(axis) / np.linalg.norm(axis))
    token, X_CJ = joint_frame(unit)
    np.testing.assert_allclose(X_CJ.apply(np.eye(3)["XYZ".index(token)]), unit, atol=1e-15)


def test_bodies_articulations_and_static_objects(full: tuple[Scene, Usd.Stage]) -> None:
    from pxr import UsdPhysics

    scene, stage = full
    bodies = {str(p.GetPath()) for p in stage.Traverse() if p.HasAPI(UsdPhysics.RigidBodyAPI)}
    moving = [item for item in scene.objects if not item.fixed or item.joints]
    assert bodies == {f"/World/Objects/{item.name}/{link.name}" for item in moving for link in item.links}
    assert bodies == {str(p.GetPath()) for p in stage.Traverse() if p.HasAPI(UsdPhysics.MassAPI)}
    roots = [str(p.GetPath()) for p in stage.Traverse() if p.HasAPI(UsdPhysics.ArticulationRootAPI)]
    assert roots == ["/World/Objects/cabinet", "/World/Objects/fan/base"]
    anchor = UsdPhysics.Joint(stage.GetPrimAtPath("/World/Objects/cabinet/Joints/Anchor"))
    assert anchor.GetPrim().IsA(UsdPhysics.FixedJoint)
    assert [str(p) for p in anchor.GetBody1Rel().GetTargets()] == ["/World/Objects/cabinet/carcass"]
    assert not stage.GetPrimAtPath("/World/Objects/fan/Joints/Anchor")


def test_linked_links_do_not_collide_with_each_other(full: tuple[Scene, Usd.Stage]) -> None:
    assert filtered_pairs(full[1]) == {
        frozenset(pair)
        for pair in (
            ("cabinet/carcass", "cabinet/drawer"), ("cabinet/carcass", "cabinet/door"), ("fan/base", "fan/rotor"),
            ("cabinet/carcass", "cabinet/handle"), ("cabinet/door", "cabinet/handle"),
        )
    }  # fmt: skip
    # The drawer can meet the door and its handle; the fan has no links that are not linked.
    for path, touching in (("cabinet", True), ("fan/base", False)):
        prim = full[1].GetPrimAtPath(f"/World/Objects/{path}")
        assert prim.GetAttribute("newton:selfCollisionEnabled").Get() is touching
        assert prim.GetAttribute("physxArticulation:enabledSelfCollisions").Get() is touching


def filtered_pairs(stage: Usd.Stage) -> set[frozenset[str]]:
    from pxr import UsdPhysics

    found = set()
    for prim in stage.Traverse():
        if prim.HasAPI(UsdPhysics.FilteredPairsAPI):
            targets = UsdPhysics.FilteredPairsAPI(prim).GetFilteredPairsRel().GetTargets()
            assert all(stage.GetPrimAtPath(target) for target in targets)
            names = [str(path).removeprefix("/World/Objects/") for path in (prim.GetPath(), *targets)]
            found |= {frozenset((names[0], name)) for name in names[1:]}
    return found


def test_scene_pairs_name_bodies_or_the_colliders_of_what_has_none(mechanical: tuple[Scene, Usd.Stage]) -> None:
    pairs = filtered_pairs(mechanical[1])
    assert frozenset(("ball/body", "gripper/left")) in pairs
    assert frozenset(("pot/lid", "table/body/Colliders/shape")) in pairs
    assert frozenset(("pot/grip", "pot/lid")) in pairs
    assert frozenset(("pot/body", "pot/lid")) not in pairs  # a free joint connects nothing


def test_ball_and_free_joints(mechanical: tuple[Scene, Usd.Stage]) -> None:
    from pxr import UsdPhysics

    _, stage = mechanical
    swing = stage.GetPrimAtPath("/World/Objects/pendulum/Joints/swing")
    assert swing.IsA(UsdPhysics.SphericalJoint)
    assert swing.GetAttribute("newton:damping").Get() == pytest.approx(0.01 * np.pi / 180)
    assert swing.GetAttribute("newton:armature").Get() == pytest.approx(0.001)
    assert not stage.GetPrimAtPath("/World/Objects/pot/Joints/rests")
    lid = stage.GetPrimAtPath("/World/Objects/pot/lid")
    assert lid.HasAPI(UsdPhysics.RigidBodyAPI)
    roots = [str(p.GetPath()) for p in stage.Traverse() if p.HasAPI(UsdPhysics.ArticulationRootAPI)]
    assert roots == [f"/World/Objects/{path}" for path in ("gripper", "pendulum/post", "pot/body", "pot/lid")]


def test_a_fixed_object_with_a_free_part_is_valid(tmp_path: Path) -> None:
    """Two articulations in one object: the fixed one has its root at its anchor, or one would lie in the other."""
    from pxr import UsdPhysics

    item = pot(fixed=True)
    hinge = dataclasses.replace(item.joints[0], type=JointType.CONTINUOUS)
    stage = written(scene_of(dataclasses.replace(item, joints=(hinge, *item.joints[1:]))), tmp_path / "x")
    assert validation_errors(stage) == []
    roots = [str(p.GetPath()) for p in stage.Traverse() if p.HasAPI(UsdPhysics.ArticulationRootAPI)]
    assert roots == ["/World/Objects/pot/lid", "/World/Objects/pot/Joints/Anchor"]
    still = written(scene_of(item), tmp_path / "y")  # its handle is welded: only the lid moves
    assert validation_errors(still) == []
    bodies = [p.GetName() for p in still.Traverse() if p.HasAPI(UsdPhysics.RigidBodyAPI)]
    assert bodies == ["lid", "flap", "knob"]


def test_mimics_follow_in_physx_and_in_newton(mechanical: tuple[Scene, Usd.Stage]) -> None:
    follower = mechanical[1].GetPrimAtPath("/World/Objects/gripper/Joints/right_slide")
    assert {"PhysxMimicJointAPI:rotX", "NewtonMimicAPI"} <= set(follower.GetPrimTypeInfo().GetAppliedAPISchemas())
    for name in ("newton:mimicJoint", "physxMimicJoint:rotX:referenceJoint"):
        targets = [str(path) for path in follower.GetRelationship(name).GetTargets()]
        assert targets == ["/World/Objects/gripper/Joints/left_slide"]
    values = {
        name: follower.GetAttribute(name).Get()
        for name in (
            "newton:mimicCoef0",
            "newton:mimicCoef1",
            "physxMimicJoint:rotX:gearing",
            "physxMimicJoint:rotX:offset",
        )
    }
    assert list(values.values()) == pytest.approx([0.02, -0.5, 0.5, -0.02])


def test_a_hinge_that_follows_counts_in_degrees(tmp_path: Path) -> None:
    item = gripper()
    turning = tuple(dataclasses.replace(j, type=JointType.REVOLUTE) for j in item.joints)
    stage = written(scene_of(dataclasses.replace(item, joints=turning)), tmp_path / "x")
    follower = stage.GetPrimAtPath("/World/Objects/gripper/Joints/right_slide")
    assert follower.GetAttribute("newton:mimicCoef0").Get() == pytest.approx(np.degrees(0.02))
    assert follower.GetAttribute("newton:mimicCoef1").Get() == -0.5


def test_losses_of_mechanisms_are_stated() -> None:
    losses = {loss.path: loss for loss in compile_usd(mechanisms()).losses}
    assert set(losses) == {
        "friction", "torsional_friction", "rolling_friction", "pendulum.swing.damping",
        "pot.swivel.damping",
    }  # fmt: skip
    item = gripper()
    mixed = (dataclasses.replace(item.joints[0], type=JointType.REVOLUTE), item.joints[1])
    found = {loss.path for loss in compile_usd(scene_of(dataclasses.replace(item, joints=mixed))).losses}
    assert "gripper.right_slide.mimic" in found


def test_a_welded_object_that_is_fixed_has_no_bodies(tmp_path: Path) -> None:
    from pxr import UsdPhysics

    item = cabinet(fixed=True)
    welds = tuple(dataclasses.replace(joint, type=JointType.FIXED) for joint in item.joints)
    scene = scene_of(dataclasses.replace(item, joints=welds))
    stage = written(scene, tmp_path / "welded")
    assert not any(p.HasAPI(UsdPhysics.RigidBodyAPI) or p.IsA(UsdPhysics.Joint) for p in stage.Traverse())
    handle = read_stage(stage).links["cabinet.handle"]
    X_OL = link_poses(scene.objects[0])
    assert handle.pose is not None
    np.testing.assert_allclose(pose_of(handle.pose).matrix, (item.X_WO @ X_OL["handle"]).matrix, atol=1e-10)
    assert handle.mass == pytest.approx(0.07, rel=1e-6)
    assert [x.path for x in compile_usd(scene).losses][1:] == ["cabinet.slide", "cabinet.hinge", "cabinet.weld"]
    assert validation_errors(stage) == []
