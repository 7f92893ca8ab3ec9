"""Propose new layouts in which objects are placed around an anchor, subject to a recipe's constraints.

The predicates of each object are chosen first, uniformly among the allowed ones. The objects are then placed one after
another, starting with the largest. Each placement is drawn uniformly from all allowed and free placements. If an object
cannot be placed, all objects are placed again, up to a maximum number of attempts.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from simfoundry.cousins.layout.arrangement import Arrangement, Placeable, by_area
from simfoundry.cousins.layout.constraints import DROPPED, SIDES, PlacementConstraints, placement_constraints, side_axis
from simfoundry.cousins.layout.drop_sampling import drop
from simfoundry.cousins.layout.rejection_sampling import Allowed, Found, Mask, Region, Rng
from simfoundry.cousins.layout.supports import Support
from simfoundry.cousins.layout.twin import Twin, TwinError
from simfoundry.cousins.recipe.candidate import Reason, Rejected
from simfoundry.geometry.frames import Array, Pose, Poses, rotations
from simfoundry.predicates.judging.view import StateBatch
from simfoundry.spec.models.cousins import SceneAxis

# Maximum number of attempts to place all objects.
STARTS = 4

# Retry placing distractors only if at most this many, or an eighth of them, remain; retrying does not create space.
ALMOST = 4


@dataclass(frozen=True, eq=False)
class Layout:
    """New object poses.

    Attributes:
        asked: Conditions that must hold at rest.
        poses: Poses X_WO of all objects that move, including riders, keyed by name.
        dropped: Names of the objects that were dropped onto or into the anchor. They may move as they come to rest.
    """

    asked: tuple[str, ...]
    poses: Mapping[str, Pose]
    dropped: frozenset[str] = frozenset()

    def extended(self, table: Arrangement, asked: tuple[str, ...] = ()) -> Layout:
        """Return a copy of this layout that includes the objects placed in an arrangement."""
        poses = MappingProxyType({**self.poses, **table.moved})
        return Layout((*self.asked, *asked), poses, self.dropped | table.dropped)


# The unchanged layout of the twin.
NOTHING = Layout((), MappingProxyType({}))


def propose(twin: Twin, axis: SceneAxis, rng: Rng, layout: Layout = NOTHING) -> Layout | Rejected:
    """Place the objects of an axis around its anchor, in addition to the objects in an earlier ``layout``.

    Raises:
        ImpossibleError: The axis can never be satisfied. This is detected before sampling.
    """
    asks = placement_constraints(twin, axis)
    chosen = {name: asks.sets[name][int(rng.integers(len(asks.sets[name])))] for name in asks.order}
    asked = tuple(f"{word}({name}, {asks.anchor})" for name in sorted(chosen) for word in chosen[name])
    reason: Reason | None = None
    for _ in range(STARTS):
        table = Arrangement(twin, layout.poses, asks.order)
        placed = (_place(table, asks, axis, name, chosen[name], rng) for name in asks.order)
        reason = next(filter(None, placed), None)
        if reason is None:
            return layout.extended(table, asked)
    assert reason is not None
    return Rejected((reason,))


def scatter(twin: Twin, names: Sequence[str], rng: Rng, on: str = "", layout: Layout = NOTHING) -> Layout | Rejected:
    """Place objects at random, without predicates, on the object ``on`` or on any level surface in the twin.

    An object that does not fit on its randomly chosen surface is placed on a different surface.

    Args:
        twin: The twin.
        names: Names of the objects to place.
        rng: Random generator.
        on: Name of the object to place them on. By default, all suitable surfaces in the twin are used.
        layout: Earlier layout to which the placements are added.

    Raises:
        TwinError: There is no level surface.
    """
    places = twin.places if not on else tuple(filter(None, [twin[on].support(None)]))
    if not places:
        raise TwinError(f"objects cannot be placed on `{on or twin.ground}`, because it has no level surface")
    outlines = {name: Placeable.of(twin, name, places[0].name).outline for name in names}
    order = by_area({name: outline.area for name, outline in outlines.items()})
    areas = np.array([place.area for place in places])
    reason: Reason | None = None
    for _ in range(STARTS):
        chosen = rng.choice(len(places), len(order), p=areas / areas.sum()) if len(places) > 1 else [0] * len(order)
        table = Arrangement(twin, layout.poses, order)
        left, reason = _put_all(table, order, [places[k] for k in chosen], places, rng)
        if reason is None:
            return layout.extended(table)
        if left > max(ALMOST, len(order) // 8):
            break
    assert reason is not None
    return Rejected((reason,))


def _put_all(
    table: Arrangement, names: Sequence[str], chosen: Sequence[Support], places: Sequence[Support], rng: Rng
) -> tuple[int, Reason | None]:
    """Place objects on their chosen supports.

    Returns:
        The number of objects that were not placed, and a reason if an object does not fit on any support.
    """
    left, twin = len(names), table.twin
    for place in places:
        things = [Placeable.of(twin, n, place.name, names) for n, at in zip(names, chosen, strict=True) if at is place]
        while things:
            failed = table.put_all(things, place, rng)
            placed = len(things) if failed is None else things.index(failed[0])
            left -= placed
            if failed is None:
                break
            thing = failed[0]
            if not any(_put_at(table, thing.name, other, names, rng) for other in places if other is not place):
                return left, no_room(table, thing, place, failed[1])
            left, things = left - 1, things[placed + 1 :]
    return left, None


def _put_at(table: Arrangement, name: str, place: Support, names: Sequence[str], rng: Rng) -> bool:
    """Place an object on a support.

    Returns:
        True if the object fits there.
    """
    thing = Placeable.of(table.twin, name, place.name, names)
    region = thing.anywhere(place)
    found = table.find(thing, region, rng)
    if found.spot is not None:
        table.put(thing, region.z, found.spot)
    return found.spot is not None


def _place(
    table: Arrangement, asks: PlacementConstraints, axis: SceneAxis, name: str, words: tuple[str, ...], rng: Rng
) -> Reason | None:
    """Place an object.

    Returns:
        The reason why the object could not be placed, or None if it was placed.
    """
    if set(words) & set(DROPPED):
        return drop(table, asks.anchor, Placeable.of(table.twin, name, asks.anchor, asks.order), words, axis, rng)
    support, solids = asks.support, table.twin.solids
    assert support is not None
    thing = Placeable.of(table.twin, name, support.name, asks.order)
    region = _region(table, thing, asks.anchor, support, axis)
    least, most = axis.gap

    def at_gap() -> bool:
        return least <= solids.distance(name, asks.anchor, most + 1e-3) <= most

    found = table.find(thing, region, rng, _judged(table, thing, asks.anchor, words, region.z), at_gap)
    if found.spot is None:
        return no_room(table, thing, support, found, asks.anchor, words, axis)
    table.put(thing, region.z, found.spot)
    return None


def _region(table: Arrangement, thing: Placeable, anchor: str, support: Support, axis: SceneAxis) -> Region:
    """Return a region that contains all placements of an object within the maximum gap to the anchor."""
    lowest, highest = table.twin.box(anchor, table.poses[anchor])
    reach = axis.gap[1] + thing.outline.radius
    low = np.maximum(support.bounds[0], lowest[:2] - reach)
    high = np.minimum(support.bounds[1], highest[:2] + reach)
    turn = (math.radians(axis.yaw_deg[0]), math.radians(axis.yaw_deg[1]))
    return Region(low, np.maximum(low, high), turn, support, thing.height(support))


def _judged(table: Arrangement, thing: Placeable, anchor: str, words: tuple[str, ...], z: float) -> Allowed:
    """Return a function that marks the candidates that satisfy the predicates."""
    twin, X_WA = table.twin, table.poses[anchor]
    condition = {"all": [f"{word}({thing.name}, {anchor})" for word in words]}
    upright = thing.upright.rotation
    joints = {k: v for k, v in twin.state.joints.items() if k.partition(".")[0] in (thing.name, anchor)}

    def allowed(x: Array, y: Array, yaw: Array) -> Mask:
        n = len(x)
        turn = rotations(np.column_stack([np.cos(yaw / 2), np.zeros((n, 2)), np.sin(yaw / 2)]))
        poses = {
            thing.name: Poses(np.column_stack([x, y, np.full(n, z)]), turn @ upright),
            anchor: Poses.constant(X_WA, n),
        }
        batch = StateBatch(n, poses, {k: np.full(n, v) for k, v in joints.items()})
        return twin.judge.batch(condition, batch)[0]

    return allowed


def no_room(
    table: Arrangement,
    thing: Placeable,
    support: Support,
    found: Found,
    anchor: str = "",
    words: tuple[str, ...] = (),
    axis: SceneAxis | None = None,
) -> Reason:
    """Return the reason why an object could not be placed. It states the free area and the candidate counts."""
    there = table.there
    wide, free = thing.outline.width, max(0.0, support.area - there.area_on(support.height))
    numbers = {"width_m": wide, "shadow_m2": thing.outline.area, "support_m2": support.area, "free_m2": free}
    numbers |= {"tries": float(found.tried), "standing": float(found.standing), "allowed": float(found.allowed)}
    where = f"{' and '.join(SIDES.get(w, w) for w in words)} `{anchor}`" if anchor else f"on `{support.name}`"
    text = f"no room {where}: "
    strip = strip_beside(table.twin, anchor, support, words) if anchor else None
    if strip is not None:
        numbers |= {"strip_deep_m": strip[0], "strip_long_m": strip[1]}
        text += f"the strip of `{support.name}` there is {strip[0]:.2f} m x {strip[1]:.2f} m, and "
    text += f"`{thing.name}` is {wide:.2f} m wide; {free:.3f} of {support.area:.3f} m^2 of `{support.name}` is free; "
    text += f"of {found.tried:,} candidates, {found.standing:,} are on `{support.name}`"
    if axis is not None:
        text += f", {found.allowed:,} satisfy the predicates, and none is free at a gap of {axis.gap[0]:g} to "
        text += f"{axis.gap[1]:g} m"
    return Reason("no_room", text, numbers)


def strip_beside(twin: Twin, anchor: str, support: Support, words: tuple[str, ...]) -> tuple[float, float] | None:
    """Return the depth and length [m] of the strip of a support beside an anchor.

    The depth is measured outward from the anchor. The result is None if the predicates ``words`` do not request a side.
    """
    axis = next((axis for word in words if (axis := side_axis(twin.scene.viewer, word)) is not None), None)
    if axis is None:
        return None
    across = np.array([-axis[1], axis[0], 0.0])
    edge = twin.shape(anchor, twin.state.poses[anchor]).extent(axis)[1]
    corners = np.column_stack([support.corners, np.zeros(len(support.corners))])
    return max(0.0, float((corners @ axis).max()) - edge), float(np.ptp(corners @ across))
