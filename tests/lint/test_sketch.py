"""A sketch agrees with the lowered scene: where things are, how large, what they are made of."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from simfoundry.lint.convex import Piece, penetration
from simfoundry.lint.sketch import sketch
from simfoundry.lint.solids import Point, convex_polygons
from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.lower import lower
from simfoundry.spec.load import load
from tests.conftest import REPOSITORY
from tests.lint.scenes import BOWL, drawn, written

SCENES = sorted((REPOSITORY / "specs").rglob("*.scene.yaml"))


@pytest.mark.parametrize("path", SCENES, ids=[p.stem for p in SCENES])
def test_things_are_where_lowering_puts_them(path: Path) -> None:
    loaded = load(path)
    things = sketch(loaded).things
    for item in lower(loaded).objects:
        thing = things[item.name]
        if thing.exact:
            assert thing.X_WO.p == pytest.approx(item.X_WO.p, abs=3e-4)
        else:
            assert thing.X_WO.p[:2] == pytest.approx(item.X_WO.p[:2], abs=1e-6)
        assert np.array(thing.X_WO.r).reshape(3, 3) == pytest.approx(item.X_WO.rotation, abs=1e-6)


def test_what_a_drawer_holds_moves_with_it(tmp_path: Path) -> None:
    (tmp_path / "chest.asset.yaml").write_text(
        "simfoundry: asset/1\nname: chest\nlinks:\n"
        "  body: {parts: {box: {shape: {box: [0.3, 0.3, 0.2]}}}, mass: 3}\n"
        "  tray: {parts: {box: {shape: {box: [0.2, 0.2, 0.02]}, pose: {xyz: [0, 0, 0.01]}}}, mass: 1}\n"
        "  knob: {parts: {box: {shape: {sphere: 0.01}, pose: {xyz: [0.1, 0, 0]}}}, mass: 0.1}\n"
        "joints:\n"
        "  slide: {type: prismatic, parent: body, child: tray, limits: [0, 1], axis: [2, 0, 0], pose: {yaw_deg: 90}}\n"
        "  turn: {type: revolute, parent: tray, child: knob, limits_deg: [-90, 90], pose: {xyz: [0, 0, 0.1]}}\n"
    )
    scene = """
        chest: {asset: chest.asset.yaml, pose: {xyz: [1, 2, 3], yaw_deg: 30}, joints: {slide: 0.2, turn: {deg: 90}}}
    """
    path = written(tmp_path, scene)
    item = next(o for o in lower(load(path)).objects if o.name == "chest")
    chest = drawn(path).things["chest"]
    poses = link_poses(item)
    for name in poses:
        expected = item.X_WO @ poses[name]
        assert chest.limb_frame(name).p == pytest.approx(expected.p)
        assert np.array(chest.limb_frame(name).r).reshape(3, 3) == pytest.approx(expected.rotation)
    # The tray slides along the body's y, by the yaw of its frame; the knob is turned once more.
    assert chest.X_WO.local(chest.limb_frame("tray").p) == pytest.approx((0, 0.2, 0))
    assert chest.X_WO.local(chest.limb_frame("knob").apply((0.1, 0, 0))) == pytest.approx((-0.1, 0.2, 0.1))
    assert chest.limb_frame("turn") == chest.limb_frame("knob")


OUTLINES: dict[str, tuple[Point, ...]] = {
    "square": ((0, 0), (1, 0), (1, 1), (0, 1)),
    "clockwise": ((0, 0), (0, 1), (1, 1), (1, 0)),
    "L": ((0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)),
    "comb": ((0, 0), (5, 0), (5, 3), (4, 3), (4, 1), (3, 1), (3, 3), (2, 3), (2, 1), (1, 1), (1, 3), (0, 3)),
    "straight corners": ((0, 0), (1, 0), (2, 0), (2, 1), (2, 2), (1, 2), (1, 1), (0, 1)),
}


def area(corners: list[Point] | tuple[Point, ...]) -> float:
    pairs = zip(corners, (*corners[1:], corners[0]), strict=True)
    return float(sum(a[0] * b[1] - a[1] * b[0] for a, b in pairs) / 2)


@pytest.mark.parametrize("name", OUTLINES)
def test_an_outline_is_tiled_by_convex_polygons(name: str) -> None:
    outline = OUTLINES[name]
    tiles = convex_polygons(outline)
    assert sum(map(area, tiles)) == pytest.approx(abs(area(outline)))
    for tile in tiles:
        turns = zip(tile, (*tile[1:], tile[0]), (*tile[2:], *tile[:2]), strict=True)
        assert all((b[0] - a[0]) * (c[1] - b[1]) - (b[1] - a[1]) * (c[0] - b[0]) >= -1e-12 for a, b, c in turns)
    assert len(convex_polygons(OUTLINES["square"])) == 1


def test_a_bowl_is_hollow(tmp_path: Path) -> None:
    pieces = drawn(written(tmp_path, f"bowl: {{{BOWL}, mass: 0.3}}")).things["bowl"].touching
    for x, z, filled in (
        (0, 0.002, True),
        (0, 0.03, False),
        (0.03, 0.03, False),
        (0.0625, 0.03, True),
        (0.1, 0.05, False),
    ):
        grain = Piece.of([(x, 0.001, z)], 1e-3)
        assert any(penetration(grain, p) > 1e-4 for p in pieces) is filled
