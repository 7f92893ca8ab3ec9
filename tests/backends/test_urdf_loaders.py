"""What the loaders of URDF builds for SAPIEN and Drake rest on; the loaders themselves run in ``simfoundry verify``."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from itertools import combinations
from pathlib import Path
from types import ModuleType
from unittest import mock

import pytest

from simfoundry.backends import compile_scene
from tests.scenes import full_scene, scene_of, solid
from tests.scenes import pose as posed

TEMPLATES = Path(__file__).parents[2] / "simfoundry" / "backends" / "templates"


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
    assert {"load_sapien.py", "load_drake.py"} <= set(files)


def test_surfaces_stand_in_the_order_of_the_urdf() -> None:
    from simfoundry.scene.model import Capsule

    files = compile_scene(scene_of(solid("pill", Capsule(0.02, 0.06), posed(0, 0, 1))), "urdf").files
    surfaces = json.loads(files["physics.json"])["objects"]["pill"]["links"]["body"]
    text = files["pill.urdf"].decode()
    at = [text.index(f'<collision name="{name}"') for name in surfaces]
    assert list(surfaces) == ["shape_tube", "shape_top", "shape_bottom"]
    assert at == sorted(at)


@pytest.fixture(scope="module")
def silence() -> Callable[[set[str], set[frozenset[str]]], dict[str, int]]:
    """From SAPIEN's loader, without SAPIEN."""
    module = ModuleType("loader")
    module.__file__ = str(TEMPLATES / "sapien_load.py")
    with mock.patch.dict(sys.modules, {"sapien": mock.MagicMock(), "sapien.physx": mock.MagicMock()}):
        exec((TEMPLATES / "sapien_load.py").read_text(), module.__dict__)
    found: Callable[[set[str], set[frozenset[str]]], dict[str, int]] = module.__dict__["silence"]
    return found


@pytest.mark.parametrize("silent", ["", "ab", "ab bc", "ab bc ac", "ab cd", "ab bc cd da", "ab ac ad bc bd cd"])
def test_links_share_a_bit_if_and_only_if_they_are_silent(
    silence: Callable[[set[str], set[frozenset[str]]], dict[str, int]], silent: str
) -> None:
    pairs = {frozenset(pair) for pair in silent.split()}
    masks = silence(set("abcd"), pairs)
    for a, b in combinations("abcd", 2):
        assert bool(masks[a] & masks[b]) == (frozenset((a, b)) in pairs)
