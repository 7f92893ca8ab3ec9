"""Joints and contacts of a document in the lowered scene, and back in the words of a document."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest

from simfoundry.geometry.frames import Pose
from simfoundry.scene.kinematics import contact_pairs, excluded_link_pairs, free_motions, link_poses, trees
from simfoundry.scene.lower import lower
from simfoundry.scene.model import Drive, JointType, Mimic, Scene
from simfoundry.scene.state import SceneState, with_state
from simfoundry.spec.load import load, load_scene
from simfoundry.spec.models.scene import SceneSpec
from simfoundry.spec.yaml.write import to_yaml
from tests.mechanisms import chain, mechanisms, pot
from tests.scenes import cabinet, pose

ASSET = """\
simfoundry: asset/1
name: lamp
materials:
  rubber: {density: 1100, friction: 0.9, torsional_friction: 0.003, rolling_friction: 0.001}
links:
  foot: {material: rubber, parts: {disk: {shape: {cylinder: {radius: 0.1, height: 0.02}}}}}
  arm: {density: 700, parts: {bar: {shape: {box: [0.02, 0.02, 0.3]}}}}
  shade: {density: 300, parts: {dome: {shape: {sphere: 0.06}}}}
  left: {density: 700, parts: {flap: {shape: {box: [0.02, 0.05, 0.05]}}}}
  right: {density: 700, parts: {flap: {shape: {box: [0.02, 0.05, 0.05]}}}}
  cap: {density: 700, parts: {lid: {shape: {box: [0.05, 0.05, 0.01]}}}}
joints:
  shoulder: {type: ball, parent: foot, child: arm, pose: {xyz: [0, 0, 0.02]}, damping: 0.01, friction: 0.2}
  neck: {type: revolute, parent: arm, child: shade, pose: {xyz: [0, 0, 0.3]}, axis: [0, 1, 0], limits_deg: [-60, 60],
         drive: {stiffness: 5, damping: 0.1, force_limit: 2}}
  left_hinge: {type: continuous, parent: shade, child: left, pose: {xyz: [0.1, 0, 0]},
               mimic: {joint: right_hinge, offset: 0.1}}
  right_hinge: {type: revolute, parent: shade, child: right, pose: {xyz: [-0.1, 0, 0]}, limits_deg: [-40, 40],
                mimic: {joint: neck, multiplier: -0.5}}
  rests: {type: free, parent: foot, child: cap, pose: {xyz: [0, 0.2, 0]}}
no_contact: [[shade, foot]]
"""
SCENE = """\
simfoundry: scene/1
name: room
objects:
  desk: {fixed: true, shape: {box: [1, 1, 0.04]}}
  lamp:
    asset: lamp.asset.yaml
    pose: {xyz: [0.1, 0.2, 0.5]}
    joints: {shoulder: {rpy_deg: [20, -10, 30]}, neck: {deg: 30}, rests: {xyz: [0.1, 0, 0.05], yaw_deg: 40}}
  cup: {shape: {sphere: 0.03}, mass: 0.1, pose: {xyz: [0, 0, 2]}}
no_contact: [[cup, lamp.shade], [lamp.left, lamp.right], [lamp.rests, desk]]
"""


@pytest.fixture
def scene(tmp_path: Path) -> Scene:
    (tmp_path / "lamp.asset.yaml").write_text(ASSET)
    (tmp_path / "room.scene.yaml").write_text(SCENE)
    return lower(load_scene(tmp_path / "room.scene.yaml"))


def test_limits_of_force_and_speed_are_lowered(tmp_path: Path) -> None:
    limited = ASSET.replace("drive: {stiff", "effort: 1.5, velocity_deg: 90, drive: {stiff")
    (tmp_path / "lamp.asset.yaml").write_text(limited)
    (tmp_path / "room.scene.yaml").write_text(SCENE)
    scene = lower(load_scene(tmp_path / "room.scene.yaml"))
    neck = next(joint for joint in scene.object("lamp").joints if joint.name == "neck")
    assert neck.effort == 1.5 and neck.velocity == pytest.approx(math.pi / 2)
    assert neck.drive is not None and neck.drive.force_limit == 1.5  # the joint's limit is the smaller one


def test_states_of_all_joints_are_lowered(scene: Scene) -> None:
    joints = {joint.name: joint for joint in scene.object("lamp").joints}
    neck = math.radians(30)
    assert {name: j.position for name, j in joints.items() if j.has_axis} == pytest.approx(
        {"neck": neck, "right_hinge": -0.5 * neck, "left_hinge": -0.5 * neck + 0.1}
    )
    assert joints["left_hinge"].mimic == Mimic("right_hinge", 1.0, 0.1)
    assert joints["neck"].drive == Drive(5.0, 0.1, neck, 2.0)  # the target is where it starts
    turned = pose(0, 0, 0, *np.radians([20, -10, 30]))
    assert joints["shoulder"].motion.angle_to(turned) < 1e-12
    np.testing.assert_allclose(joints["rests"].motion.p, [0.1, 0, 0.05])
    X_OL = link_poses(scene.object("lamp"))
    np.testing.assert_allclose(X_OL["arm"].p, [0, 0, 0.02])
    np.testing.assert_allclose(X_OL["shade"].p, [0, 0, 0.02] + turned.rotation @ [0, 0, 0.3], atol=1e-12)
    np.testing.assert_allclose(X_OL["cap"].p, [0.1, 0.2, 0.05])
    foot = scene.object("lamp").root.colliders[0]
    assert (foot.torsional_friction, foot.rolling_friction) == (0.003, 0.001)


def test_pairs_without_contact_are_lowered(scene: Scene) -> None:
    assert scene.no_contact == (("cup", "lamp.shade"), ("desk", "lamp.cap"))  # a joint means the link that it moves
    assert scene.object("lamp").no_contact == (("shade", "foot"), ("left", "right"))


def test_a_settled_state_is_written_in_the_words_of_the_document(scene: Scene, tmp_path: Path) -> None:
    spec = load(tmp_path / "room.scene.yaml").spec
    assert isinstance(spec, SceneSpec)
    start = SceneState.initial(scene)
    turned = pose(0, 0, 0, 0.4, -0.2, 1.1)
    moved = SceneState.of(
        start.poses,
        {**start.joints, "lamp.neck": 0.2, "lamp.right_hinge": -0.1, "lamp.left_hinge": 0.0},
        {"lamp.shoulder": turned, "lamp.rests": pose(0.02, 0.01, -0.005, yaw=0.3)},
    )
    after = with_state(spec, scene, moved)
    assert set(after.objects["lamp"].joints) == {"shoulder", "neck", "rests"}  # what follows is not written
    (tmp_path / "after.scene.yaml").write_text(to_yaml(after))
    again = SceneState.initial(lower(load_scene(tmp_path / "after.scene.yaml")))
    assert again.joints["lamp.left_hinge"] == pytest.approx(0.0, abs=1e-12)
    for name, motion in moved.motions.items():
        assert again.motions[name].angle_to(motion) < 2e-4
        assert np.linalg.norm(again.motions[name].p - motion.p) < 1e-4


def test_links_touch_unless_a_joint_connects_them() -> None:
    """The handle is welded to the door: the carcass, which carries the door, does not touch it either."""
    assert set(excluded_link_pairs(cabinet())) == {
        ("carcass", "drawer"), ("carcass", "door"), ("carcass", "handle"), ("door", "handle")
    }  # fmt: skip
    assert contact_pairs(cabinet()) == (("drawer", "door"), ("drawer", "handle"))
    assert contact_pairs(chain(4)) == (("box_0", "box_2"), ("box_0", "box_3"), ("box_1", "box_3"))
    assert contact_pairs(chain(4, no_contact=(("box_3", "box_0"),))) == (("box_0", "box_2"), ("box_1", "box_3"))
    assert ("body", "lid") in contact_pairs(pot())


def test_a_free_joint_parts_an_object() -> None:
    item = pot(fixed=True)
    body, lid = trees(item)
    assert [link.name for link in body.links] == ["body", "grip"]
    assert [link.name for link in lid.links] == ["lid", "flap", "knob"]
    assert [joint.name for joint in lid.joints] == ["hinge", "swivel"]
    assert (body.name, lid.name, body.fixed, lid.fixed) == ("pot", "pot.lid", True, False)
    assert lid.X_WT.angle_to(item.X_WO @ link_poses(item)["lid"]) < 1e-12
    assert [[link.name for link in tree.links] for tree in trees(cabinet())] == [
        ["carcass", "drawer", "door", "handle"]
    ]


def test_free_motions_undo_kinematics() -> None:
    """Of two free joints, one below the other."""
    item = pot()
    loose = dataclasses.replace(item.joints[3], type=JointType.FREE, motion=pose(0.1, 0.2, -0.1, 0.3, 0.1, -0.7))
    item = dataclasses.replace(item, joints=(*item.joints[:3], loose))
    X_OL = link_poses(item)
    motions = free_motions(item, {"hinge": item.joints[2].position}, {"lid": X_OL["lid"], "knob": X_OL["knob"]})
    for joint in (item.joints[1], loose):
        assert motions[joint.name].angle_to(joint.motion) < 1e-9
        assert np.linalg.norm(motions[joint.name].p - joint.motion.p) < 1e-12


def test_an_initial_state_names_each_joint_where_it_belongs() -> None:
    state = SceneState.initial(mechanisms())
    assert set(state.joints) == {"gripper.left_slide", "gripper.right_slide", "pot.hinge"}
    assert set(state.motions) == {"pendulum.swing", "pot.rests", "pot.swivel"}
    item = mechanisms().object("pot")
    asked = SceneState.of({}, {"pot.hinge": 0.2}, {"pot.rests": Pose.of([1, 2, 3])})
    own = asked.of_object(item)
    assert set(own) == {"rests", "hinge", "swivel"}
    assert own["hinge"] == 0.2
    assert isinstance(own["swivel"], Pose) and own["swivel"].angle_to(item.joints[3].motion) < 1e-12
