"""Where a held thing can be let go so that it comes to rest on or in another."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from simfoundry.scene.crossings import Solid, met, solid
from simfoundry.scene.drop import heights
from simfoundry.scene.frames import Array, Pose, quat_from_rpy
from simfoundry.scene.hulls import Hulls, hulls
from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.model import Scene, SceneObject
from simfoundry.scene.state import SceneState
from simfoundry.scene.walls import DIRECTIONS, WALLED, hollow

TURNS = 8
"""Turns about the vertical that are tried."""

GRID, SPACING = 7, 0.012
"""Most positions along each side of the target that are tried, and the least distance between them [m]."""

SUNK = 0.008
"""How far below the rim of a hollow the lowest point of what is in it lies at least [m]."""

UP = np.array([0.0, 0.0, 1.0])

ENOUGH, LOOKED_AT = 24, 400
"""So many places are enough to choose from, and so many are looked at for it at most."""

LONG = 1.8
"""A thing is long whose greatest extent is this many times its next: it may also stand on its end."""

LEANS = (0.0, 0.3, 0.6)
"""How far a long thing may lean [rad] when it goes into a hollow."""


@dataclass(frozen=True, eq=False)
class PlaceAt:
    """A pose in which a thing touches what is to carry it; ``cost`` is smaller for better ones."""

    X_WO: Pose
    cost: float


def at_state(item: SceneObject, state: SceneState) -> SceneObject:
    """The object where the state has it."""
    now = state.of_object(item)
    joints = []
    for joint in item.joints:
        value = now.get(joint.name)
        if isinstance(value, Pose):
            joints.append(replace(joint, motion=value))
        else:
            joints.append(joint if value is None else replace(joint, position=value))
    return replace(item, X_WO=state.poses[item.name], joints=tuple(joints))


def places(scene: Scene, state: SceneState, name: str, target: str, inside: bool) -> list[PlaceAt]:
    """Poses of ``name`` on or inside ``target`` (an object or a link of one), from the best."""
    return list(islice(_places(scene, state, name, target, inside), ENOUGH))


def _places(scene: Scene, state: SceneState, name: str, target: str, inside: bool) -> Iterator[PlaceAt]:
    item = scene.object(name)
    owner, _, link = target.partition(".")
    carrier = at_state(scene.object(owner), state)
    whole = hulls(carrier)
    number = [each.name for each in carrier.links].index(link) if link else None
    part = whole if number is None else whole.of_link(number)
    X_WC = carrier.X_WO @ link_poses(carrier)[link] if link else carrier.X_WO
    others = [hulls(at_state(o, state)) for o in scene.objects if o.name not in (name, owner) and not o.fixed]
    walls = solid(scene.object(owner), state, [link] if link else None)
    top = part.extent(UP)[1]
    turned = [(R, penalty, hulls(replace(item, X_WO=R))) for R, penalty in _turns(item, state, inside)]
    tried = [
        (penalty + 10 * off, k, spot)
        for k, (_, penalty, _) in enumerate(turned)
        for spot, off in _spots(part, X_WC, inside)
    ]
    for cost, k, spot in sorted(tried, key=lambda t: t[0])[:LOOKED_AT]:
        X_turn, _, shape = turned[k]
        at = np.array([*(spot - shape.middle(np.eye(3))[:2]), 0.0])
        held = shape.moved(at)
        lift = _rest(held, whole, number)
        if lift is None:
            continue
        foot = lift + shape.extent(UP)[0]
        if inside and not (foot < top - SUNK and _walled(walls, np.array([*spot, foot]))):
            continue
        if any(float(heights(held, other).max()) > lift for other in others):
            continue
        yield PlaceAt(Pose.of(at + lift * UP, X_turn.q), cost)


def _walled(walls: Solid, foot: Array) -> bool:
    """Whether a point at the foot of a thing has walls on most sides, there or a little higher."""
    angle = (np.arange(DIRECTIONS) + 0.25) * (2 * math.pi / DIRECTIONS)
    rays = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(DIRECTIONS)])
    return any(met(walls, foot + height * UP, rays).sum() >= WALLED for height in (0.001, 0.01, 0.02))


def _spots(part: Hulls, X_WC: Pose, inside: bool) -> list[tuple[Array, float]]:
    """Positions in the plane [m] over a target, from its middle outwards, and how far from the middle they are."""
    middle = part.middle(X_WC.rotation)
    if inside:
        middle = hollow(part, middle, X_WC.rotation)
    axes = X_WC.rotation[:, :2]
    half = [(high - low) / 2 for low, high in (part.extent(axes[:, k]) for k in range(2))]
    rows, columns = (np.linspace(-0.8, 0.8, int(np.clip(1.6 * h / SPACING, 2, GRID))) * h for h in half)
    offsets = [(0.0, 0.0), *((a, b) for a in rows for b in columns)]
    spots = [((middle + axes @ np.array(offset))[:2], math.hypot(*offset)) for offset in offsets]
    return sorted(spots, key=lambda s: s[1])


def _turns(item: SceneObject, state: SceneState, inside: bool) -> Iterator[tuple[Pose, float]]:
    """Rotations of the thing and what is to say against them: as it stands, turned about the vertical; then on end."""
    now = Pose.of(q=state.poses[item.name].q)
    for k in range(TURNS):
        yield Pose.of(q=quat_from_rpy(0.0, 0.0, 2 * math.pi * k / TURNS)) @ now, 0.0
    axis = _long_axis(item)
    if axis is None or not inside:
        return
    level = now.rotation[:, axis]
    heading = math.atan2(level[1], level[0])
    for lean in LEANS:
        for sign in (1, -1):
            # Turned about the level axis across it, until it points down or up.
            upend = Pose.of(q=_about(heading + math.pi / 2, sign * (math.pi / 2 - lean))) @ now
            for k in range(TURNS):
                turn = Pose.of(q=quat_from_rpy(0.0, 0.0, 2 * math.pi * k / TURNS))
                yield turn @ upend, 0.3 + 0.1 * lean


def _about(heading: float, angle: float) -> Array:
    half = angle / 2
    return np.array([math.cos(half), math.sin(half) * math.cos(heading), math.sin(half) * math.sin(heading), 0.0])


def _long_axis(item: SceneObject) -> int | None:
    """The axis of its frame along which a thing is long, if any."""
    shape = hulls(replace(item, X_WO=Pose.of()))
    size = shape.size()
    axis = int(size.argmax())
    return axis if size[axis] > LONG * float(np.delete(size, axis).max()) else None


def _rest(held: Hulls, whole: Hulls, link: int | None) -> float | None:
    """How far a thing is lifted when it comes down on the target [m]; None where it meets another part first."""
    touching = heights(held, whole)
    lift = float(touching.max())
    if not math.isfinite(lift):
        return None
    if link is not None and whole.link[np.unravel_index(int(touching.argmax()), touching.shape)[1]] != link:
        return None
    return lift
