"""A scene in a few lines."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from simfoundry.geometry.frames import Pose, quat_from_rpy
from simfoundry.scene.lower import lower
from simfoundry.scene.object_shapes import bounds, world_bounds
from simfoundry.scene.summary import summary, tree
from simfoundry.spec.load import load_scene
from simfoundry.spec.models.scene import SceneSpec
from tests.tabletop import box, one, rgba

SCENE = """\
simfoundry: scene/1
name: kitchen
materials:
  wood: {density: 700}
objects:
  desk: {fixed: true, shape: {box: [0.8, 0.6, 0.04]}, material: wood, pose: {xyz: [0, 0, -0.02]}}
  book: {shape: {box: [0.2, 0.15, 0.03]}, mass: 0.4, pose: {xyz: [0, 0, 0.015], yaw_deg: 30}}
  ball: {shape: {sphere: 0.035}, mass: {value: 0.1, range: [0.05, 0.2], source: vlm}, pose: {xyz: [0, 0, 0.065]}}
  lathe: {shape: {lathe: {profile: [[0, 0], [0.03, 0], [0.04, 0.05], [0, 0.05]]}}, mass: 0.25, pose: {xyz: [0.3, 0, 0]}}
  a: {shape: {capsule: {radius: 0.01, height: 0.05}}, mass: 0.01, pose: {xyz: [0, 0.2, 0.1]}}
  b: {shape: {cylinder: {radius: 0.02, height: 0.05}}, mass: 0.01, pose: {xyz: [0, 0.2, 0.2]}}
  box: {asset: box.asset.yaml, fixed: true, joints: {lid: {deg: 30}}, pose: {xyz: [0, -0.2, 0.05]}}
cameras:
  front: {size: [64, 48], fx: 60, fy: 60, pose: {xyz: [-0.8, 0.1, 0.7], look_at: [0, 0, 0]}}
relations: [OnTop(book, desk), OnTop(ball, book), OnTop(lathe, desk), OnTop(a, b), OnTop(b, a), OnTop(box, desk)]
"""
ASSET = """\
simfoundry: asset/1
name: box
links:
  body: {density: 500, parts: {block: {shape: {box: [0.12, 0.1, 0.1]}}}}
  lid: {density: 500, parts: {plate: {shape: {box: [0.12, 0.1, 0.01]}, pose: {xyz: [0.06, 0, 0.005]}}}}
joints:
  lid: {type: revolute, parent: body, child: lid, pose: {xyz: [-0.06, 0, 0.05]}, axis: [0, -1, 0], limits_deg: [0, 70]}
"""
TREE = """\
kitchen  7 objects, 0.77 kg
├─ desk  box 80.0 x 60.0 x 4.0 cm  fixed  1 collider
│  ├─ book  box 20.0 x 15.0 x 3.0 cm  0.4 kg  1 collider
│  │  └─ ball  sphere 7.0 x 7.0 x 7.0 cm  0.1 kg (0.05 to 0.2, vlm)  1 collider
│  ├─ lathe  lathe 8.0 x 8.0 x 5.0 cm  0.25 kg  1 collider (convex part) within 0.34 mm
│  └─ box  2 links 12.5 x 10.0 x 16.9 cm  fixed  2 colliders
│        ~ lid  revolute  at 0.524
└─ a  capsule 2.0 x 2.0 x 7.0 cm  0.01 kg  1 collider
   └─ b  cylinder 4.0 x 4.0 x 5.0 cm  0.01 kg  1 collider
camera front  64 x 48"""


@pytest.fixture
def shown(tmp_path: Path) -> tuple[dict[str, object], str]:
    (tmp_path / "box.asset.yaml").write_text(ASSET)
    (tmp_path / "kitchen.scene.yaml").write_text(SCENE)
    loaded = load_scene(tmp_path / "kitchen.scene.yaml")
    assert isinstance(loaded.spec, SceneSpec)
    facts = summary(lower(loaded), loaded.spec)
    return facts, tree(facts)


def test_the_tree(shown: tuple[dict[str, object], str]) -> None:
    """A ring of `OnTop`, as of a and b, loses nothing and shows nothing twice."""
    assert shown[1] == TREE


def test_the_facts(shown: tuple[dict[str, object], str]) -> None:
    objects = shown[0]["objects"]
    assert isinstance(objects, dict)
    assert objects["ball"]["mass_range"] == [0.05, 0.2] and objects["ball"]["mass_by"] == "vlm"
    assert objects["ball"]["on"] == "book" and objects["desk"]["on"] is None
    assert objects["book"]["size"] == [0.2, 0.15, 0.03] and objects["book"]["xyz"] == [0, 0, 0.015]
    assert objects["desk"]["fixed"] is True and objects["desk"]["mass"] == pytest.approx(0.8 * 0.6 * 0.04 * 700)


def test_bounds_turn_with_the_object() -> None:
    X_WO = Pose.of([0.1, 0.2, 0.3], quat_from_rpy(0.3, -0.5, 0.9))
    brick = one("brick", box(0.2, 0.1, 0.04), rgba("808080"), X_WO)
    low, high = bounds(brick)
    assert np.allclose(high, [0.1, 0.05, 0.02]) and np.allclose(low, -high)
    low, high = world_bounds(brick, X_WO)
    half = np.abs(X_WO.rotation) @ np.array([0.1, 0.05, 0.02])
    assert np.allclose(low, X_WO.p - half) and np.allclose(high, X_WO.p + half)


def test_what_is_placed_hangs_below_what_it_is_placed_on_or_in(tmp_path: Path) -> None:
    (tmp_path / "a.scene.yaml").write_text(
        "simfoundry: scene/1\nname: a\nobjects:\n"
        "  table: {fixed: true, shape: {box: [1, 1, 0.1]}}\n"
        "  cup: {shape: {box: [0.1, 0.1, 0.1]}, mass: 1, place: {on: table}}\n"
        "  lid: {shape: {box: [0.1, 0.1, 0.1]}, mass: 1, place: {on: table, left_of: cup}}\n"
        "relations: [OnTop(lid, cup)]\n"
    )
    loaded = load_scene(tmp_path / "a.scene.yaml")
    assert isinstance(loaded.spec, SceneSpec)
    objects = summary(lower(loaded), loaded.spec)["objects"]
    assert {name: item["on"] for name, item in objects.items()} == {"table": None, "cup": "table", "lid": "cup"}
