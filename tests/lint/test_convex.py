"""Depths and heights of convex pieces, against MuJoCo and against their definition."""

from __future__ import annotations

import math
import random

import mujoco
import numpy as np
import pytest

from simfoundry.lint.convex import Piece, lift, penetration
from simfoundry.lint.frames import Frame, Vec, rotation_of, turned

KINDS = ("box", "sphere", "cylinder", "capsule")
# A box and a capsule are left to the second test: MuJoCo's own function for them is approximate for deep overlaps.
PAIRS = [(a, b) for a in KINDS for b in KINDS if {a, b} != {"box", "capsule"}]
MARGIN = 5e-4


def piece(kind: str, size: list[float]) -> Piece:
    """A primitive with MuJoCo's half sizes, in its own frame."""
    x, y, z = size
    match kind:
        case "box":
            return Piece.of([(i * x, j * y, k * z) for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)])
        case "sphere":
            return Piece.of([(0.0, 0.0, 0.0)], x)
        case "cylinder":
            return Piece.of_discs([(0.0, 0.0, -y), (0.0, 0.0, y)], (x, x))
    return Piece.of([(0.0, 0.0, -y), (0.0, 0.0, y)], x)


def quaternion(rng: random.Random) -> list[float]:
    q = [rng.gauss(0, 1) for _ in range(4)]
    return [v / math.hypot(*q) for v in q]


def random_piece(rng: random.Random, kind: str) -> tuple[Piece, str]:
    """A posed primitive, and the same in MJCF."""
    size = [rng.uniform(0.01, 0.1) for _ in range(3)]
    q, p = quaternion(rng), [rng.uniform(-0.08, 0.08) for _ in range(3)]
    numbers = {n: " ".join(map(repr, v)) for n, v in (("pos", p), ("quat", q), ("size", size))}
    geom = f'<geom type="{kind}" pos="{numbers["pos"]}" quat="{numbers["quat"]}" size="{numbers["size"]}"/>'
    return piece(kind, size).moved(Frame(turned(q), (p[0], p[1], p[2]))), geom


def mujoco_distance(a: str, b: str) -> float:
    xml = f'<mujoco><option ccd_tolerance="1e-9" ccd_iterations="500"/><worldbody>{a}{b}</worldbody></mujoco>'
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return float(mujoco.mj_geomDistance(model, data, 0, 1, 1.0, np.zeros(6)))


@pytest.mark.parametrize(("first", "second"), PAIRS)
def test_the_depth_is_that_of_mujoco(first: str, second: str) -> None:
    rng = random.Random(f"{first} {second}")
    overlapping = 0
    for _ in range(25):
        (a, geom_a), (b, geom_b) = random_piece(rng, first), random_piece(rng, second)
        distance, depth = mujoco_distance(geom_a, geom_b), penetration(a, b)
        assert penetration(b, a) == pytest.approx(depth, abs=MARGIN) or max(depth, penetration(b, a)) <= 0
        if distance < -MARGIN:
            overlapping += 1
            assert depth == pytest.approx(-distance, abs=MARGIN)
        elif distance > MARGIN:
            assert depth <= 0
    assert overlapping >= 5


def moved(a: Piece, v: Vec) -> Piece:
    return a.moved(Frame(p=v))


@pytest.mark.parametrize("second", KINDS)
@pytest.mark.parametrize("first", KINDS)
def test_no_way_out_is_shorter_than_the_depth(first: str, second: str) -> None:
    rng = random.Random(f"out {first} {second}")
    generator = np.random.default_rng(3)
    tried = 0
    while tried < 3:
        (a, _), (b, _) = random_piece(rng, first), random_piece(rng, second)
        depth = penetration(a, b)
        if depth < 0.005:
            continue
        tried += 1
        least, best = math.inf, np.zeros(3)
        for spread in (1.0, 0.1, 0.01, 0.001):  # all around, then ever nearer to the best
            for v in best + spread * generator.normal(size=(400, 3)):
                n: Vec = tuple(v / np.linalg.norm(v))
                way = b.extent(n)[1] - a.extent(n)[0]
                assert way >= depth - 1e-4
                if way < least:
                    least, best = way, np.array(n)
        assert least == pytest.approx(depth, abs=5e-3)


@pytest.mark.parametrize("second", KINDS)
@pytest.mark.parametrize("first", KINDS)
def test_what_is_lifted_onto_another_just_touches_it(first: str, second: str) -> None:
    rng = random.Random(f"lift {first} {second}")
    met = passed = 0
    for _ in range(12):
        (a, _), (b, _) = random_piece(rng, first), random_piece(rng, second)
        high, low = lift(a, b), lift(a, b, -1.0)
        assert (high is None) == (low is None)
        if high is None or low is None:
            passed += 1
            assert all(penetration(moved(a, (0, 0, z / 100)), b) <= 2e-4 for z in range(-40, 41, 2))
            continue
        met += 1
        assert low <= high + 1e-4
        assert penetration(moved(a, (0, 0, high + 3e-4)), b) <= 1e-4
        assert penetration(moved(a, (0, 0, low - 3e-4)), b) <= 1e-4
        if high - low > 0.02:  # a good hold, where a little less lift means an overlap that can be seen
            assert penetration(moved(a, (0, 0, high - 0.005)), b) > 0
            assert penetration(moved(a, (0, 0, low + 0.005)), b) > 0
    assert met >= 4
    assert met + passed == 12


def test_a_shallow_overlap_is_not_looked_into() -> None:
    a = piece("box", [0.1, 0.1, 0.1])
    assert penetration(a, moved(a, (0.15, 0.02, 0.01))) == pytest.approx(0.05, abs=1e-6)
    assert 0 < penetration(a, moved(a, (0.199, 0, 0)), ignored=0.002) <= 0.002
    assert penetration(a, moved(a, (0.15, 0, 0)), ignored=0.1) <= 0.1


def test_flat_pieces_have_no_inside() -> None:
    sheet = Piece.of([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)])
    assert penetration(sheet, sheet) == 0.0
    point = Piece.of([(0.0, 0.0, 0.0)])
    assert penetration(point, point) == 0.0
    assert lift(point, moved(point, (0.0, 0.0, 1.0))) in (None, pytest.approx(1.0))


ANGLES = (0.0, 1e-5, 1e-3, 1.0, 30.0, 45.0, 90.0, -90.0, 180.0)
OFFSETS = (0.0, 1e-6, 0.01, 0.03125, 0.07, -0.07)
SHAPES = (piece("box", [0.05] * 3), piece("cylinder", [0.04, 0.05, 0]), piece("cylinder", [0.05, 0.0025, 0]))


def both_depths(a: int, b: int, tilt: float, turn: float, yaw: float, p: Vec) -> tuple[float, float]:
    """The depth of two of ``SHAPES``, and the same asked the other way round."""
    first = SHAPES[a].moved(Frame(rotation_of((tilt, turn, 0.0), None)))
    second = SHAPES[b].moved(Frame(rotation_of((0.0, tilt, yaw), None), p))
    return penetration(first, second), penetration(second, first)


def test_faces_in_one_plane_leave_no_hole() -> None:
    there, back = both_depths(1, 0, 1e-5, 1e-5, 1.0, (0.0, 1e-6, 1e-6))
    assert there == pytest.approx(0.09, abs=2e-4)  # both are sunk into one another along an axis of the box
    assert back == pytest.approx(there, abs=2e-4)


def test_the_order_of_two_things_does_not_matter() -> None:
    rng = random.Random(3)
    for _ in range(700):
        a, b = rng.randrange(3), rng.randrange(3)
        tilt, turn, yaw = (rng.choice(ANGLES) for _ in range(3))
        x, y, z = (rng.choice(OFFSETS) for _ in range(3))
        there, back = both_depths(a, b, tilt, turn, yaw, (x, y, z))
        assert there == pytest.approx(back, abs=1e-3) or max(there, back) <= 1e-4
