"""Scene cousins: new layouts in which objects stand around an anchor as a recipe allows.

Predicates are chosen first, evenly over all that each object may have. The objects are then placed one after another,
largest first, each uniformly over all allowed and free places. If one finds no place, all start over, up to a limit.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from simfoundry.cousins.layout.arrangement import Arrangement, Placeable
from simfoundry.cousins.layout.constraints import DROPPED, SIDES, PlacementConstraints, placement_constraints, side_axis
from simfoundry.cousins.layout.drop_sampling import drop
from simfoundry.cousins.layout.rejection_sampling import Found, Mask, Region
from simfoundry.cousins.layout.supports import Support
from simfoundry.cousins.layout.twin import Twin, TwinError
from simfoundry.cousins.recipe.candidate import Reason, Rejected
from simfoundry.geometry.frames import Array, Pose, Poses, rotations
from simfoundry.predicates.judging.view import StateBatch
from simfoundry.spec.models.cousins import SceneAxis

STARTS = 4
"""Number of times that all objects are placed anew after one finds no place."""

ALMOST = 4
"""With many distractors, retry only if at most this many, or an eighth, are unplaced: a retry creates no space."""


@dataclass(frozen=True, eq=False)
class Layout:
    """New poses of objects: ``poses`` X_WO by name of all objects that move, riders included.

    ``asked`` are the conditions that must hold at rest; ``dropped`` objects may move as they come to rest on or in the
    anchor; ``tries`` counts candidates.
    """

    anchor: str
    asked: tuple[str, ...]
    poses: Mapping[str, Pose]
    dropped: frozenset[str] = frozenset()
    tries: int = 0

    def and_then(self, table: Arrangement, anchor: str, asked: tuple[str, ...], tries: int) -> Layout:
        """Return this layout with the objects placed on a table added to it."""
        return Layout(
            self.anchor or anchor,
            (*self.asked, *asked),
            MappingProxyType({**self.poses, **table.moved}),
            self.dropped | table.dropped,
            self.tries + tries,
        )


NOTHING = Layout("", (), MappingProxyType({}))
"""The unchanged layout of the twin."""


def propose(twin: Twin, axis: SceneAxis, rng: np.random.Generator, layout: Layout = NOTHING) -> Layout | Rejected:
    """Place the objects of an axis around its anchor, on top of an earlier ``layout``.

    Raises :class:`ImpossibleError` before any sampling if the axis can never be satisfied.
    """
    asks = placement_constraints(twin, axis)
    chosen = {name: asks.sets[name][int(rng.integers(len(asks.sets[name])))] for name in asks.order}
    reason: Reason | None = None
    tries = 0
    for _ in range(STARTS):
        table = Arrangement(twin, layout.poses, asks.order)
        for name in asks.order:
            reason = _place(table, asks, axis, name, chosen[name], rng)
            if reason is not None:
                break
        tries += table.tries
        if reason is None:
            asked = tuple(f"{word}({name}, {asks.anchor})" for name in sorted(chosen) for word in chosen[name])
            return layout.and_then(table, asks.anchor, asked, tries)
    assert reason is not None
    return Rejected((reason,))


def scatter(
    twin: Twin, names: Sequence[str], rng: np.random.Generator, on: str = "", layout: Layout = NOTHING
) -> Layout | Rejected:
    """Place objects anywhere on ``on``, or uniformly over all free places of the twin, without predicates.

    An object that finds no space at its randomly chosen place is moved to another. Raises :class:`TwinError` if there
    is no level surface.
    """
    places = twin.places if not on else tuple(filter(None, [twin[on].support(None)]))
    if not places:
        raise TwinError(f"`{on or twin.ground}` has no level surface, so no object can be placed on it")
    order = by_size(twin, names, places[0].name)
    areas = np.array([place.area for place in places])
    reason: Reason | None = None
    tries = 0
    for _ in range(STARTS):
        chosen = rng.choice(len(places), len(order), p=areas / areas.sum()) if len(places) > 1 else [0] * len(order)
        table = Arrangement(twin, layout.poses, order)
        left, reason = _put_all(table, order, [places[k] for k in chosen], places, rng)
        tries += table.tries
        if reason is None:
            return layout.and_then(table, "", (), tries)
        if left > max(ALMOST, len(order) // 8):
            break
    assert reason is not None
    return Rejected((reason,))


def _put_all(
    table: Arrangement,
    names: Sequence[str],
    chosen: Sequence[Support],
    places: Sequence[Support],
    rng: np.random.Generator,
) -> tuple[int, Reason | None]:
    """Place objects at their chosen supports; return the number left over, and the reason if one finds no space
    anywhere.
    """
    left = len(names)
    for place in places:
        things = [
            Placeable.of(table.twin, name, place.name, names)
            for name, at in zip(names, chosen, strict=True)
            if at is place
        ]
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


def _put_at(table: Arrangement, name: str, place: Support, names: Sequence[str], rng: np.random.Generator) -> bool:
    """Place an object on a support; return whether it found space there."""
    thing = Placeable.of(table.twin, name, place.name, names)
    region = thing.anywhere(place)
    found = table.find(thing, region, rng)
    if found.spot is not None:
        table.put(thing, region.z, found.spot)
    return found.spot is not None


def by_size(twin: Twin, names: Iterable[str], on: str) -> tuple[str, ...]:
    """Return names by decreasing shadow size, ties in alphabetical order."""
    areas = {name: Placeable.of(twin, name, on).outline.area for name in names}
    return tuple(sorted(areas, key=lambda name: (-round(areas[name], 9), name)))


def _place(
    table: Arrangement,
    asks: PlacementConstraints,
    axis: SceneAxis,
    name: str,
    words: tuple[str, ...],
    rng: np.random.Generator,
) -> Reason | None:
    """Place one object; return the reason if it finds no place."""
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
    """Region in which an object is no farther from the anchor than the maximum gap."""
    lowest, highest = table.twin.box(anchor, table.poses[anchor])
    reach = axis.gap[1] + thing.outline.radius
    low = np.maximum(support.bounds[0], lowest[:2] - reach)
    high = np.minimum(support.bounds[1], highest[:2] + reach)
    turn = (math.radians(axis.yaw_deg[0]), math.radians(axis.yaw_deg[1]))
    return Region(low, np.maximum(low, high), turn, support, thing.height(support))


def _judged(
    table: Arrangement, thing: Placeable, anchor: str, words: tuple[str, ...], z: float
) -> Callable[[Array, Array, Array], Mask]:
    """Return a vectorized test for candidates that satisfy the predicates, evaluated by the judge itself."""
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
    """Reason why an object found no place, with the suitable and the free area of the support."""
    there = table.there
    wide, free = thing.outline.width, max(0.0, support.area - there.area_on(support.height))
    numbers = {
        "width_m": wide,
        "shadow_m2": thing.outline.area,
        "support_m2": support.area,
        "free_m2": free,
        "tries": float(found.tried),
        "standing": float(found.standing),
        "allowed": float(found.allowed),
    }
    where = f"{' and '.join(SIDES.get(w, w) for w in words)} `{anchor}`" if anchor else f"on `{support.name}`"
    text = f"no room {where}: "
    strip = strip_beside(table.twin, anchor, support, words) if anchor else None
    if strip is not None:
        numbers |= {"strip_deep_m": strip[0], "strip_long_m": strip[1]}
        text += f"the strip of `{support.name}` there is {strip[0]:.2f} m x {strip[1]:.2f} m, "
    text += f"`{thing.name}` is {wide:.2f} m wide; {free:.3f} of {support.area:.3f} m^2 of `{support.name}` are free; "
    text += f"{found.tried:,} tries, {found.standing:,} on `{support.name}`"
    if axis is not None:
        text += f", {found.allowed:,} where asked, none free at a gap of {axis.gap[0]:g} to {axis.gap[1]:g} m"
    return Reason("no_room", text, numbers)


def strip_beside(twin: Twin, anchor: str, support: Support, words: tuple[str, ...]) -> tuple[float, float] | None:
    """Depth and length [m] of the part of a support beside an anchor, from its edge outward; None if no side is
    requested.
    """
    sides = [axis for word in words if (axis := side_axis(twin.scene.viewer, word)) is not None]
    if not sides:
        return None
    axis = sides[0]
    across = np.array([-axis[1], axis[0], 0.0])
    edge = twin.shape(anchor, twin.state.poses[anchor]).extent(axis)[1]
    corners = np.column_stack([support.corners, np.zeros(len(support.corners))])
    return max(0.0, float((corners @ axis).max()) - edge), float(np.ptp(corners @ across))
