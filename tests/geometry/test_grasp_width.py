"""Grasp widths: simple shapes, what fingers can do with them, and one figure for each kind of object."""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest

from simfoundry.cousins.objects.item import lowered
from simfoundry.geometry.grasp_width import grasp_width
from simfoundry.scene.lower import lower_file
from simfoundry.scene.object_shapes import solid
from simfoundry.spec.load import load_kind
from simfoundry.spec.models.asset import AssetSpec
from tests.conftest import PACKAGE, REPOSITORY

ASSETS = REPOSITORY / "specs" / "assets"

KINDS = {
    "apple": 71.3,
    "banana": 13.0,
    "baseball": 71.9,
    "blue_cup": 5.8,
    "bowl": 8.9,
    "brown_box": 5.0,
    "burger": 70.3,
    "cabinet": 11.8,
    "cube": 50.0,
    "cup": 5.8,
    "eraser": 50.0,
    "grapes": 6.8,
    "marker": 15.6,
    "mug": 5.5,
    "orange_cup": 5.8,
    "orange_marker": 15.6,
    "organizer": 5.0,
    "plate": 227.5,
    "pot": 4.2,
    "red_bottle": 20.8,
    "red_marker": 15.6,
    "stove": 31.5,
    "tennis_ball": 65.8,
    "trash_can": 50.0,
}
"""Widths in millimeters: walls of what is hollow, caps and necks, balls at their equator, a plate from rim to rim."""

SHAPES = {
    "shape: {box: [0.2, 0.06, 0.3]}": 0.06,
    "shape: {box: [0.03, 0.03, 0.2]}": 0.03,
    "shape: {sphere: 0.0335}": 0.066,
    "shape: {cylinder: {radius: 0.05, height: 0.02}}": 0.1,
    "shape: {cylinder: {radius: 0.006, height: 0.15}}": 0.012,
    "shape: {capsule: {radius: 0.02, height: 0.2}}": 0.04,
    "shape: {prism: {outline: [[0, 0], [0.2, 0], [0.2, 0.05], [0, 0.05]], height: 0.1}}": 0.05,
    "shape: {prism: {outline: [[0, 0], [0.1, 0], [0.05, 0.0866025]], height: 0.1}}": 0.0866025,
}


def width(tmp_path: Path, what: str) -> float:
    file = tmp_path / "it.scene.yaml"
    file.write_text(f"simfoundry: scene/1\nname: it\nobjects: {{it: {{mass: 0.1, {what}}}}}\n")
    return grasp_width(solid(lower_file(file).object("it")))


@pytest.mark.parametrize("name", KINDS)
def test_each_kind_has_one_width(name: str) -> None:
    spec = load_kind(ASSETS / f"{name}.asset.yaml", "asset/1").spec
    assert isinstance(spec, AssetSpec)
    assert 1000 * grasp_width(solid(lowered(spec, ASSETS, name))) == pytest.approx(KINDS[name], abs=0.06)


def test_the_table_is_about_every_kind() -> None:
    assert sorted(KINDS) == sorted(file.name.removesuffix(".asset.yaml") for file in ASSETS.glob("*.asset.yaml"))


@pytest.mark.parametrize("yaw", [0, 33])
@pytest.mark.parametrize("shape", SHAPES)
def test_a_shape_is_as_wide_as_between_its_nearest_sides(shape: str, yaw: float, tmp_path: Path) -> None:
    found = width(tmp_path, f"{shape}, pose: {{xyz: [0.4, -0.1, 0.2], yaw_deg: {yaw}}}")
    assert found == pytest.approx(SHAPES[shape], rel=0.012)


def test_an_object_is_measured_as_it_lies(tmp_path: Path) -> None:
    lying = "shape: {cylinder: {radius: 0.05, height: 0.02}}, pose: {rpy_deg: [90, 0, 25]}"
    assert width(tmp_path, lying) == pytest.approx(0.02, rel=0.012)


def test_a_bowl_is_taken_by_its_wall_and_a_dimple_is_no_bowl(tmp_path: Path) -> None:
    wall = width(
        tmp_path,
        "shape: {lathe: {profile: [[0, 0], [0.07, 0], [0.07, 0.06], [0.065, 0.06], [0.065, 0.005], [0, 0.005]]}}",
    )
    assert wall == pytest.approx(0.0055, abs=0.0006)  # 5 mm, and a little for the bend of the wall along a pad
    dimple = "shape: {lathe: {profile: [[0, 0], [0.075, 0], [0.075, 0.06], [0.03, 0.06], [0.02, 0.055], [0, 0.055]]}}"
    assert width(tmp_path, dimple) > 0.145


def test_nothing_holds_what_narrows_upward(tmp_path: Path) -> None:
    steep = "shape: {lathe: {profile: [[0, 0], [0.03, 0], [0.025, 0.1], [0, 0.1]]}}"
    assert width(tmp_path, steep) == pytest.approx(0.051, abs=0.002)
    flat = "shape: {lathe: {profile: [[0, 0], [0.04, 0], [0.01, 0.05], [0, 0.05]]}}"
    assert width(tmp_path, flat) == math.inf


@pytest.mark.parametrize(("gap", "expected"), [(0.03, 0.04), (0.01, 0.09)])
def test_fingers_go_only_where_they_have_room(gap: float, expected: float, tmp_path: Path) -> None:
    asset = "simfoundry: asset/1\nname: boards\nlinks:\n  body:\n    mass: 0.3\n    parts:\n"
    for side, y in (("left", (gap + 0.04) / 2), ("right", -(gap + 0.04) / 2)):
        asset += f"      {side}: {{shape: {{box: [0.2, 0.04, 0.1]}}, pose: {{xyz: [0, {y}, 0.05]}}}}\n"
    (tmp_path / "boards.asset.yaml").write_text(asset)
    spec = load_kind(tmp_path / "boards.asset.yaml", "asset/1").spec
    assert isinstance(spec, AssetSpec)
    assert grasp_width(solid(lowered(spec, tmp_path, "boards"))) == pytest.approx(expected, abs=1e-6)


def test_grasp_width_and_reach_are_defined_once() -> None:
    """Lints, tasks, object checks and the expert ask the same functions."""
    sources = {file: file.read_text() for file in PACKAGE.rglob("*.py")}

    def definitions(pattern: str) -> list[str]:
        return [
            f.relative_to(PACKAGE).as_posix() for f, text in sources.items() for _ in re.findall(pattern, text, re.M)
        ]

    assert definitions(r"^ *def (?:grip|grasp)_width\b") == ["geometry/grasp_width.py"]
    assert definitions(r"^ *def nearest_miss\b|^class \w*Reach\b") == ["robots/reach.py"] * 2
    users = set(definitions(r"import .*\bgrasp_width\b"))
    assert {"lint/robots.py", "cousins/tasks/context.py", "cousins/objects/checks.py"} <= users
