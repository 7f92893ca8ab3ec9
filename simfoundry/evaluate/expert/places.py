"""Release poses for a held object from which it comes to rest on or in another."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from simfoundry.geometry.crossings import HalfSpaces, met
from simfoundry.geometry.frames import Array, Pose, quat_from_rpy
from simfoundry.geometry.hulls import Hulls
from simfoundry.geometry.vertical_contact import heights
from simfoundry.geometry.walls import DIRECTIONS, WALLED, hollow
from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.model import Scene, SceneObject
from simfoundry.scene.object_shapes import hulls, solid
from simfoundry.scene.state import SceneState, object_at

TURNS = 8
"""Number of rotations about the vertical that are tried."""

GRID, SPACING = 7, 0.012
"""Maximum number of positions along each side of the target, and their minimum spacing [m]."""

SUNK = 0.008
"""Minimum depth of an object's lowest point below the rim of a cavity [m]."""

UP = np.array([0.0, 0.0, 1.0])

ENOUGH, LOOKED_AT = 48, 400
"""Number of places of a kind that suffice, and maximum number of candidate poses on end that are tried."""

FAR = 10.0
"""Cost of a place per meter from the center."""

LONG = 1.8
"""Minimum ratio of the two largest extents of a long object, which may also stand on end."""

LEANS = (0.0, 0.3, 0.6)
"""Tilt angles of a long object that is put into a cavity [rad]."""


@dataclass(frozen=True, eq=False)
class PlaceAt:
    """A pose in which an object touches its support; better places have a smaller ``cost``."""

    X_WO: Pose
    cost: float


@dataclass(frozen=True, eq=False)
class _Target:
    """A support: an object, or its link with index ``link``, among the other movable ones.

    ``part`` is the supporting geometry, up to the height ``top`` [m]; ``walls`` are its collision parts.
    """

    whole: Hulls
    link: int | None
    part: Hulls
    X_WC: Pose
    top: float
    walls: HalfSpaces
    others: tuple[Hulls, ...]
    inside: bool


def places(scene: Scene, state: SceneState, name: str, target: str, inside: bool) -> list[PlaceAt]:
    """Poses of ``name`` on or inside ``target`` (an object or a link of one), best first.

    First in its present orientation at the center of the free area; a long object also on end.
    """
    item, carrier = scene.object(name), _target(scene, state, name, target, inside)
    spots = _spots(carrier)
    lying = [(turn, 0.0) for turn in _turned(state.poses[name])]
    found = _central([p for place in _tried(item, lying, spots) if (p := _placed(carrier, *place)) is not None])
    if inside:
        on_end = _tried(item, list(_on_end(item, state)), spots)[:LOOKED_AT]
        found += islice((p for place in on_end if (p := _placed(carrier, *place)) is not None), ENOUGH)
    return sorted(found, key=lambda p: p.cost)


def _target(scene: Scene, state: SceneState, name: str, target: str, inside: bool) -> _Target:
    owner, _, link = target.partition(".")
    item = object_at(scene.object(owner), state)
    whole = hulls(item)
    number = [each.name for each in item.links].index(link) if link else None
    part = whole if number is None else whole.of_link(number)
    others = (o for o in scene.objects if o.name not in (name, owner) and not o.fixed)
    return _Target(
        whole=whole,
        link=number,
        part=part,
        X_WC=item.X_WO @ link_poses(item)[link] if link else item.X_WO,
        top=part.extent(UP)[1],
        walls=solid(item, state, [link] if link else None),
        others=tuple(hulls(object_at(o, state)) for o in others),
        inside=inside,
    )


def _tried(
    item: SceneObject, turns: list[tuple[Pose, float]], spots: list[tuple[Array, float]]
) -> list[tuple[Pose, Hulls, Array, float]]:
    """Combine every rotation and position, with the resulting shape and cost, in order of cost."""
    turned = [(turn, hulls(replace(item, X_WO=turn)), penalty) for turn, penalty in turns]
    every = [(turn, shape, spot, penalty + FAR * off) for turn, shape, penalty in turned for spot, off in spots]
    return sorted(every, key=lambda each: each[3])


def _placed(target: _Target, turn: Pose, shape: Hulls, spot: Array, cost: float) -> PlaceAt | None:
    """Lower an object at a position; None if it first meets another object, or is not inside as required."""
    at = np.array([*(spot - shape.middle(np.eye(3))[:2]), 0.0])
    held = shape.moved(at)
    lift = _rest(held, target.whole, target.link)
    if lift is None:
        return None
    foot = lift + shape.extent(UP)[0]
    if target.inside and not (foot < target.top - SUNK and _walled(target.walls, np.array([*spot, foot]))):
        return None
    if any(float(heights(held, other).max()) > lift for other in target.others):
        return None
    return PlaceAt(Pose.of(at + lift * UP, turn.q), cost)


def _central(found: list[PlaceAt]) -> list[PlaceAt]:
    """Places closest to the center of all found; for an object half under a lid, this is the center of the open
    half.
    """
    if not found:
        return []
    middle = np.mean([place.X_WO.p[:2] for place in found], axis=0)
    off = [float(np.linalg.norm(place.X_WO.p[:2] - middle)) for place in found]
    central = [PlaceAt(place.X_WO, FAR * distance) for place, distance in zip(found, off, strict=True)]
    return sorted(central, key=lambda place: place.cost)[:ENOUGH]


def _walled(walls: HalfSpaces, foot: Array) -> bool:
    """Return whether a point at an object's foot has walls on most sides, there or slightly higher."""
    angle = (np.arange(DIRECTIONS) + 0.25) * (2 * math.pi / DIRECTIONS)
    rays = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(DIRECTIONS)])
    return any(met(walls, foot + height * UP, rays).sum() >= WALLED for height in (0.001, 0.01, 0.02))


def _spots(target: _Target) -> list[tuple[Array, float]]:
    """Positions in the plane [m] over a target, from its center outward, and their distances from the center."""
    part, R_WC = target.part, target.X_WC.rotation
    middle = part.middle(R_WC)
    if target.inside:
        middle = hollow(part, middle, R_WC)
    axes = R_WC[:, :2]
    half = [(high - low) / 2 for low, high in (part.extent(axes[:, k]) for k in range(2))]
    rows, columns = (np.linspace(-0.8, 0.8, _odd(1.6 * h / SPACING)) * h for h in half)
    spots = [((middle + axes @ np.array([a, b]))[:2], math.hypot(a, b)) for a in rows for b in columns]
    return sorted(spots, key=lambda s: s[1])


def _odd(count: float) -> int:
    """Round to an odd number of positions up to :data:`GRID`, so that the center is one of them."""
    return 2 * (int(np.clip(count, 3, GRID)) // 2) + 1


def _turned(pose: Pose) -> list[Pose]:
    """Rotations of a pose about the vertical."""
    now = Pose.of(q=pose.q)
    return [Pose.of(q=quat_from_rpy(0.0, 0.0, 2 * math.pi * k / TURNS)) @ now for k in range(TURNS)]


def _on_end(item: SceneObject, state: SceneState) -> Iterator[tuple[Pose, float]]:
    """Yield rotations of a long object on its ends, tilted by up to :data:`LEANS`, with their costs."""
    axis = _long_axis(item)
    if axis is None:
        return
    now = Pose.of(q=state.poses[item.name].q)
    level = now.rotation[:, axis]
    heading = math.atan2(level[1], level[0])
    for lean in LEANS:
        for sign in (1, -1):
            # Rotate about the horizontal axis across it, until it points down or up.
            upend = Pose.of(q=_about(heading + math.pi / 2, sign * (math.pi / 2 - lean))) @ now
            for turn in _turned(upend):
                yield turn, 0.3 + 0.1 * lean


def _about(heading: float, angle: float) -> Array:
    half = angle / 2
    return np.array([math.cos(half), math.sin(half) * math.cos(heading), math.sin(half) * math.sin(heading), 0.0])


def _long_axis(item: SceneObject) -> int | None:
    """Axis of the object's frame along which it is long, if any."""
    shape = hulls(replace(item, X_WO=Pose.of()))
    size = shape.size()
    axis = int(size.argmax())
    return axis if size[axis] > LONG * float(np.delete(size, axis).max()) else None


def _rest(held: Hulls, whole: Hulls, link: int | None) -> float | None:
    """Height by which an object that rests on the target is lifted [m]; None if it meets another part first."""
    touching = heights(held, whole)
    lift = float(touching.max())
    if not math.isfinite(lift):
        return None
    if link is not None and whole.link[np.unravel_index(int(touching.argmax()), touching.shape)[1]] != link:
        return None
    return lift
