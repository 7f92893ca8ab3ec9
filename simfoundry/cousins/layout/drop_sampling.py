"""Place objects on or inside the anchor by dropping them onto its collision geometry."""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterable

import numpy as np

from simfoundry.cousins.layout.arrangement import Arrangement, Placeable
from simfoundry.cousins.layout.rejection_sampling import Rng
from simfoundry.cousins.layout.supports import Support
from simfoundry.cousins.layout.twin import Twin
from simfoundry.cousins.recipe.candidate import Reason
from simfoundry.geometry.cavity import Cavity, volume_samples
from simfoundry.geometry.form import Form
from simfoundry.geometry.frames import Array, Pose, quat_from_rpy, rpy_from_quat
from simfoundry.predicates.judging.thresholds import ENCLOSED
from simfoundry.scene.carriers import PlaceError
from simfoundry.scene.place import solve
from simfoundry.spec.models.cousins import SceneAxis
from simfoundry.spec.models.scene import Place

# Maximum distance [m] of an object's lowest point from an edge on which it rests; dropped objects keep a gap of 1 mm.
EDGE = 0.003

# Number of drops after which the object is considered not to fit.
DROPS = 64


def drop(
    table: Arrangement, anchor: str, thing: Placeable, words: tuple[str, ...], axis: SceneAxis, rng: Rng
) -> Reason | None:
    """Place an object on or inside the anchor. All poses that are free and satisfy the predicates are equally likely.

    An object that must be on the anchor is placed on one of the anchor's levels or where it first touches the anchor
    from above, and may slide from there as it settles. Poses in which it balances on a narrow edge are rejected. An
    object that must be inside the anchor is first dropped upright and, if that fails, also on its sides.

    Args:
        table: The arrangement to which the object is added.
        anchor: Name of the anchor.
        thing: The object to place.
        words: Names of the predicates that must hold between the object and the anchor.
        axis: The scene axis, which specifies the yaw range.
        rng: Random generator.

    Returns:
        The reason why the object could not be placed, or None if it was placed.
    """
    twin, X_WA = table.twin, table.poses[anchor]
    asked = {"all": [f"{word}({thing.name}, {anchor})" for word in words]}
    lowest, highest = twin.box(anchor, X_WA)
    low, high = (math.radians(v) for v in axis.yaw_deg)
    others = [name for name in table.solid if name != anchor]
    why = ""
    counts = {
        "did not fit": 0,
        "would balance on an edge": 0,
        "did not satisfy the predicates": 0,
        "collided with another object": 0,
    }
    levels = () if "Inside" in words else twin[anchor].levels if X_WA is twin.state.poses[anchor] else ()
    areas = np.array([level.area for level in levels])
    ways = [thing, *_lying(table.twin, thing)] if "Inside" in words else [thing]
    for k in range(DROPS):
        thing = ways[0] if k < DROPS // 2 else ways[k % len(ways)]
        x, y, turn = rng.random(3)
        x, y = lowest[:2] + np.array([x, y]) * (highest - lowest)[:2]
        yaw = low + turn * (high - low)
        level = levels[int(rng.choice(len(levels), p=areas / areas.sum()))] if len(levels) > 1 else None
        try:
            if level is not None and level is not levels[-1]:
                X_WO = _standing(thing, level, (float(x), float(y)), float(yaw))
            else:
                X_WO = dropped(twin, thing, anchor, X_WA, "Inside" in words, (float(x), float(y)), float(yaw))
        except PlaceError as error:
            counts["did not fit"] += 1
            why = why or error.message
            continue
        if levels and _balances(twin, thing, X_WO, float(yaw), anchor):
            counts["would balance on an edge"] += 1
            continue
        verdict = twin.judge(asked, twin.posed({anchor: X_WA, thing.name: X_WO}))
        if not verdict.value:
            counts["did not satisfy the predicates"] += 1
            why = why or verdict.why
            continue
        table.pose(thing, X_WO)
        if table.clashes(thing, [*others, anchor] if level is not None else others, anchor):
            counts["collided with another object"] += 1
            continue
        table.put(thing, float(X_WO.p[2]), (float(X_WO.p[0]), float(X_WO.p[1]), float(yaw)), dropped=True)
        return None
    said = ", ".join(f"{count} times it {what}" for what, count in counts.items() if count)
    word = "inside" if "Inside" in words else "on"
    text = f"could not place `{thing.name}` {word} `{anchor}` in {DROPS} drops: {said}" + (f"; {why}" if why else "")
    numbers = {"tries": float(DROPS)} | {what.replace(" ", "_"): float(count) for what, count in counts.items()}
    return Reason("no_place", text, numbers)


def _standing(thing: Placeable, level: Support, xy: tuple[float, float], yaw: float) -> Pose:
    """Return the pose of an object that stands on a level surface.

    The object's frame is above the point ``xy`` [m] and rotated by ``yaw`` [rad] about z.

    Raises:
        PlaceError: The object overhangs the surface.
    """
    X_WO = thing.pose(*xy, thing.height(level), yaw)
    turn = cmath.rect(1.0, yaw)
    middle = complex(*xy) + turn * thing.outline.middle
    if not level.holds(np.array([[middle.real, middle.imag]]), np.array([turn]), thing.outline.spread)[0]:
        raise PlaceError(f"`{thing.name}` would overhang the level of `{level.name}` at {level.height:.3f} m")
    return X_WO


def _balances(twin: Twin, thing: Placeable, X_WO: Pose, yaw: float, anchor: str) -> bool:
    """Return True if an object would balance on a narrow edge with its center above the edge."""
    import shapely

    edges = twin[anchor].edges
    foot = float(X_WO.p[2]) + thing.outline.low
    middle = complex(float(X_WO.p[0]), float(X_WO.p[1])) + cmath.rect(1.0, yaw) * thing.outline.middle
    point = shapely.Point(middle.real, middle.imag)
    return any(abs(foot - height) < EDGE and edge.distance(point) < EDGE for height, edge in edges)


def _lying(twin: Twin, thing: Placeable) -> list[Placeable]:
    """Return the object lying on its side in two different orientations, or an empty list if it has riders."""
    if thing.riders:
        return []
    sides = [(thing.upright @ Pose.of(q=quat_from_rpy(*rpy))) for rpy in ((math.pi / 2, 0, 0), (0, math.pi / 2, 0))]
    return [Placeable(thing.name, (), side, twin.outline(thing.name, side)) for side in sides]


def dropped(
    twin: Twin, thing: Placeable, anchor: str, X_WA: Pose, inside: bool, xy: tuple[float, float], yaw: float
) -> Pose:
    """Return the pose in which an object that is lowered from above first touches the anchor.

    Args:
        twin: The twin.
        thing: The object.
        anchor: Name of the anchor.
        X_WA: Pose of the anchor.
        inside: True to place the object inside the anchor, False to place it on the anchor.
        xy: Position of the object's frame [m].
        yaw: Rotation about z [rad].

    Raises:
        PlaceError: The object misses the anchor or does not fit.
    """
    turned = thing.pose(0.0, 0.0, 0.0, yaw)
    rpy = tuple(np.degrees(rpy_from_quat(turned.q)).tolist())
    place = Place(on=None if inside else anchor, inside=anchor if inside else None, xy=xy, rpy_deg=rpy)
    placed = {anchor: twin.item_at(anchor, X_WA)}
    found = solve(twin[thing.name].item, place, placed, twin.scene.viewer)
    return Pose.of(found.p, turned.q)


# Number of orientations to sample; neighboring orientations are about 25 degrees apart.
TURNS = 240

# Number of sample points in the object, the same as in the predicate ``Inside``.
SAMPLES = 64

# If the largest fraction over the sampled orientations is below this value, no other orientation reaches
# :data:`ENCLOSED`.
SURE = 0.4
assert SURE < ENCLOSED


def cavity_extents(hole: Cavity) -> Array:
    """Return the side lengths of a cavity's bounding box, including the walls.

    Returns:
        Array of shape (3,) [m].
    """
    cells = np.argwhere(hole.depth > 0)
    return np.asarray((np.ptp(cells, axis=0) + 1) * hole.cell)


def largest_share(forms: Iterable[Form], extents: Array) -> float:
    """Return the fraction of an object's volume that fits into a box in the best of the sampled orientations.

    ``extents`` contains the side lengths of the box [m].
    """
    found = [volume_samples(form, SAMPLES) for form in forms]
    points = np.concatenate(found)
    points = points[:: max(1, len(points) // SAMPLES)]
    if (np.sort(np.ptp(points, axis=0)) <= np.sort(extents)).all():
        return 1.0
    best = 0
    for quaternion in _orientations():
        turned = Pose.of(q=quaternion).apply(points)
        within = [_covered(turned[:, k], float(extents[k])) for k in range(3)]
        for row in within[0]:  # one window per point along x; the windows along y and z are combined below
            if row.sum() > best:
                some = row.nonzero()[0]
                best = max(best, int((within[1][:, some].astype(float) @ within[2][:, some].T.astype(float)).max()))
        if best == len(points):
            break
    return best / len(points)


def _covered(values: Array, length: float) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    """Return a mask for each window of the given length that marks the values inside the window.

    Returns:
        Array of shape (n, n). Row i belongs to the window that starts at value i.
    """
    away = values[None, :] - values[:, None]
    return np.asarray((away >= 0) & (away <= length))


def _orientations() -> Array:
    """Return unit quaternions that are distributed evenly over all rotations.

    The quaternions form a super-Fibonacci spiral. See Alexa, "Super-Fibonacci Spirals: Fast, Low-Discrepancy Sampling
    of SO(3)", CVPR 2022.

    Returns:
        Quaternions (w, x, y, z), as an array of shape (TURNS, 4).
    """
    phi, psi = np.sqrt(2.0), 1.533751168755204288118041
    s = np.arange(TURNS) + 0.5
    r, big = np.sqrt(s / TURNS), np.sqrt(1 - s / TURNS)
    alpha, beta = 2 * np.pi * s / phi, 2 * np.pi * s / psi
    return np.column_stack([r * np.sin(alpha), r * np.cos(alpha), big * np.sin(beta), big * np.cos(beta)])
