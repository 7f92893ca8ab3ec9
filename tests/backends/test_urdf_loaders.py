"""What the loaders of URDF builds for SAPIEN and Drake rest on; the loaders themselves run in ``simfoundry verify``."""

from __future__ import annotations

import json
import sys
from itertools import combinations
from pathlib import Path
from types import ModuleType
from unittest import mock

import pytest

from simfoundry.backends import compile_scene
from simfoundry.runtime.files import shipped
from simfoundry.scene.lower import lower_file
from tests.scenes import full_scene, scene_of, solid
from tests.scenes import pose as posed
from tests.targets.everything import write_everything

TARGETS = shipped("targets")


def test_physics_holds_what_urdf_lacks() -> None:
    scene = full_scene()
    files = compile_scene(scene, "urdf").files
    physics = json.loads(files["physics.json"])
    assert physics["gravity"] == pytest.approx(scene.gravity.tolist())
    assert list(physics["objects"]) == [o.name for o in scene.objects]
    for item in scene.objects:
        entry = physics["objects"][item.name]
        for link in item.links:
            surfaces = entry["links"][link.name]
            for collider in link.colliders:
                parts = [s for name, s in surfaces.items() if name.startswith(collider.name)]
                assert parts
                assert all(s["friction"] == pytest.approx(collider.friction) for s in parts)
        for joint in item.joints:
            if joint.name in entry["joints"]:
                held = entry["joints"][joint.name]
                assert (held["friction"], held["armature"]) == pytest.approx((joint.friction, joint.armature))
    assert {"load_sapien.py", "load_drake.py", "load_genesis.py"} <= set(files)


def test_surfaces_stand_in_the_order_of_the_urdf() -> None:
    from simfoundry.geometry.shapes import Capsule

    files = compile_scene(scene_of(solid("pill", Capsule(0.02, 0.06), posed(0, 0, 1))), "urdf").files
    surfaces = json.loads(files["physics.json"])["objects"]["pill"]["links"]["body"]
    text = files["pill.urdf"].decode()
    at = [text.index(f'<collision name="{name}"') for name in surfaces]
    assert list(surfaces) == ["shape_tube", "shape_top", "shape_bottom"]
    assert at == sorted(at)


@pytest.fixture(scope="module")
def sapien_loader() -> ModuleType:
    """SAPIEN's loader, without SAPIEN."""
    module = ModuleType("loader")
    module.__file__ = str(TARGETS / "sapien" / "load.py")
    with mock.patch.dict(sys.modules, {"sapien": mock.MagicMock(), "sapien.physx": mock.MagicMock()}):
        exec((TARGETS / "sapien" / "load.py").read_text(), module.__dict__)
    return module


@pytest.mark.parametrize("silent", ["", "ab", "ab bc", "ab bc ac", "ab cd", "ab bc cd da", "ab ac ad bc bd cd"])
def test_links_share_a_bit_if_and_only_if_they_are_silent(sapien_loader: ModuleType, silent: str) -> None:
    pairs = {frozenset(pair) for pair in silent.split()}
    masks = sapien_loader.silence(set("abcd"), pairs)
    for a, b in combinations("abcd", 2):
        assert bool(masks[a] & masks[b]) == (frozenset((a, b)) in pairs)


def test_links_of_different_objects_meet_unless_they_are_a_pair(sapien_loader: ModuleType) -> None:
    names = [(name, "body") for name in "abcd"]
    pairs = {frozenset(names[:2]), frozenset(names[1:3])}
    everything_else = {names[3]: (1, 1)}  # PhysX's default
    kinds = sapien_loader.kinds([tuple(sorted(pair)) for pair in pairs]) | everything_else
    for one, other in combinations(names, 2):
        (a, met_by_a), (b, met_by_b) = kinds[one], kinds[other]
        assert bool(a & met_by_b or b & met_by_a) == (frozenset((one, other)) not in pairs)


def test_what_cannot_be_told_apart_touches_and_is_said(
    sapien_loader: ModuleType, capsys: pytest.CaptureFixture[str]
) -> None:
    many = [(f"cup{k:02}", "body") for k in range(40)]
    kinds = sapien_loader.kinds([(many[0], other) for other in many[1:]])
    assert {kind for kind, _ in kinds.values()} == {2, 4} and capsys.readouterr().out == ""
    kinds = sapien_loader.kinds(list(zip(many[::2], many[1::2], strict=True)))
    assert all(kind < 2**32 and met < 2**32 for kind, met in kinds.values())
    (a, met_by_a), (b, met_by_b) = kinds[many[0]], kinds[many[1]]
    assert not (a & met_by_b or b & met_by_a)
    assert list(kinds.values()).count((1, 2**32 - 1)) == 9
    assert "too few categories for 40 groups of excluded links; 9 of them still collide" in capsys.readouterr().out


def test_a_joint_may_follow_through_one_with_the_same_leader(sapien_loader: ModuleType) -> None:
    law = sapien_loader.Law
    laws = {"finger": law("driver", 2.0, 0.1), "link": law("driver", -0.5, 0.3), "other": law("motor", 1.0, 0.0)}
    direct, around = sapien_loader.ways("finger", laws)
    assert direct == laws["finger"] and around.leader == "link"
    driver = 0.7
    assert around.multiplier * (-0.5 * driver + 0.3) + around.offset == pytest.approx(2.0 * driver + 0.1)


def test_motors_and_what_passes_through_are_for_the_loaders(tmp_path: Path) -> None:
    scene = lower_file(write_everything(tmp_path, "robots"))
    physics = json.loads(compile_scene(scene, "urdf").files["physics.json"])
    slide = {"stiffness": 50.0, "damping": 5.0, "target": 0.1}
    assert physics["objects"]["cabinet"]["joints"]["slide"]["drive"] == slide
    assert "drive" not in physics["objects"]["cabinet"]["joints"]["hinge"]
    turn = {"stiffness": 100.0, "damping": 5.0, "target": 0.3, "force_limit": 20.0}
    assert physics["objects"]["arm"]["joints"]["turn"]["drive"] == turn
    ends = {tuple(end) for pair in physics["no_contact"] for end in pair}
    assert {("cup", "base"), ("cabinet", "frame"), ("cabinet", "drawer"), ("cabinet.lid", "lid")} < ends
    assert "robots" not in physics


OWN = """\
<robot name="arm">
  <link name="foot"/><link name="hand"/><link name="finger"/>
  <joint name="turn" type="revolute">
    <parent link="foot"/><child link="hand"/><limit lower="-1" upper="1" effort="8" velocity="1"/>
  </joint>
  <joint name="slide" type="prismatic">
    <parent link="hand"/><child link="finger"/><limit lower="0" upper="0.1" effort="5" velocity="1"/>
    <mimic joint="turn" multiplier="0.1" offset="0.02"/>
  </joint>
</robot>
"""


def test_a_robot_s_own_urdf_gets_stiff_motors_of_its_strength(tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_text(OWN)
    text = "simfoundry: scene/1\nname: one\nrobots:\n  arm: {model: {urdf: arm.urdf}, joints: {turn: 0.4}}\n"
    (tmp_path / "one.scene.yaml").write_text(text)
    physics = json.loads(compile_scene(lower_file(tmp_path / "one.scene.yaml"), "urdf").files["physics.json"])
    assert physics["objects"] == {}
    motor = {"stiffness": 1600.0, "damping": 80.0, "target": 0.4, "force_limit": 8.0}  # 8 N m at 5 mrad, in 50 ms
    follow = {"slide": {"joint": "turn", "multiplier": 0.1, "offset": 0.02}}
    assert physics["robots"] == {"arm": {"motors": {"turn": motor}, "follow": follow}}
