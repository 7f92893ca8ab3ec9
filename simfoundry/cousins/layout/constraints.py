"""Resolve a recipe's placement constraints, and detect impossible constraints before sampling."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from types import MappingProxyType

import numpy as np

from simfoundry.cousins.layout.arrangement import Arrangement, Placeable, by_area
from simfoundry.cousins.layout.drop_sampling import DROPS, SURE, cavity_extents, drop, largest_share
from simfoundry.cousins.layout.supports import Support, hull
from simfoundry.cousins.layout.twin import Twin
from simfoundry.cousins.recipe import library
from simfoundry.cousins.recipe.candidate import ImpossibleError, Reason
from simfoundry.geometry.cavity import cavity
from simfoundry.geometry.frames import Array, Pose
from simfoundry.geometry.hulls import Hulls
from simfoundry.predicates import PredicateError
from simfoundry.predicates.judging.bodies import Bodies
from simfoundry.predicates.judging.thresholds import ENCLOSED
from simfoundry.predicates.relative import AXES, viewer_axis
from simfoundry.scene.place import CLEARANCE
from simfoundry.spec.diagnostics import nearest
from simfoundry.spec.models.cousins import SceneAxis
from simfoundry.spec.models.predicate import parse_call, texts

# Number of rounds of :data:`DROPS` before an object that can only partly fit is rejected. For recipes in which one drop
# in fifty succeeds, 8 of 100 are wrongly rejected. Recipes with lower success rates are not useful.
DOUBTED = 2


@dataclass(frozen=True, eq=False)
class PlacementConstraints:
    """A resolved scene axis.

    Attributes:
        anchor: Name of the anchor.
        support: Level surface on which objects are placed around the anchor, or None if all objects are on or in the
            anchor.
        order: Names of the objects in placement order.
        sets: For each object, the sets of predicates that can hold simultaneously.
    """

    anchor: str
    support: Support | None
    order: tuple[str, ...]
    sets: Mapping[str, tuple[tuple[str, ...], ...]]


def placement_constraints(twin: Twin, axis: SceneAxis) -> PlacementConstraints:
    """Resolve the placement constraints of a scene axis. The result is cached in the twin.

    Raises:
        ImpossibleError: The axis can never be satisfied. The error contains all reasons.
    """
    key = axis.model_dump_json()
    if key not in twin.constraints:
        twin.constraints[key] = _resolved(twin, axis)
    return twin.constraints[key]


def anchor_of(twin: Twin, axis: SceneAxis) -> str:
    """Return the name of the anchor, or an empty string if there is none.

    If the axis does not specify an anchor, the first object in the goal that the axis does not move is used.
    """
    if axis.anchor is not None:
        return axis.anchor
    about: list[str] = []
    for text, _ in texts(twin.goal) if twin.goal is not None else ():
        args = [a.partition(".")[0] for a in parse_call(text).args]
        about += args[1:2] + args[:1]
    return next((n for n in about if n in twin.scene.by_name and n not in axis.objects), "")


def _resolved(twin: Twin, axis: SceneAxis) -> PlacementConstraints:
    reasons = list(_wrong_names(twin, axis))
    if reasons:
        raise ImpossibleError(tuple(reasons))
    anchor = anchor_of(twin, axis)
    sets = {name: sets_of(words, axis.relations_per_object) for name, words in axis.objects.items()}
    beside = any(word in SIDES for words in axis.objects.values() for word in words)
    support = _support(twin, anchor, axis) if beside else None
    if beside and support is None:
        text = f"objects cannot be placed beside `{anchor}`, because it does not rest on a level surface; it rests on "
        text += ", ".join(f"`{n}`" for n in twin.carried.get(anchor, ())) or "nothing"
        raise ImpossibleError((Reason("no_support", text),))
    for name, words in axis.objects.items():
        several = min(axis.relations_per_object, len(set(words)))
        if len(sets[name][0]) < several:
            listed = ", ".join(dict.fromkeys(words))
            text = f"`{name}` cannot satisfy {several} of {listed} at once, as required by `relations_per_object`"
            reasons.append(Reason("contradiction", text, {"together": several}))
        for word in dict.fromkeys(words):
            reasons += _never(twin, axis, anchor, support, name, word)
    if support is not None and not reasons:
        reasons += too_full(twin, (support,), axis)
    if reasons:
        raise ImpossibleError(tuple(reasons))
    on = support.name if support is not None else anchor
    order = by_area({name: twin.outline(name, twin.upright(name, on)).area for name in axis.objects})
    return PlacementConstraints(anchor, support, order, MappingProxyType(sets))


def _wrong_names(twin: Twin, axis: SceneAxis) -> Iterator[Reason]:
    names = twin.scene.by_name.keys()

    def hint(name: str) -> str:
        return nearest(name, names) or f"available objects: {', '.join(sorted(names))}"

    anchor = anchor_of(twin, axis)
    if not anchor:
        yield Reason("no_anchor", "there is no anchor, and none can be derived from a task's goal; specify `anchor`")
    elif anchor not in names:
        yield Reason("no_anchor", f"the anchor `{anchor}` does not exist; {hint(anchor)}")
    for name, words in axis.objects.items():
        if name not in names:
            yield Reason("no_object", f"`{name}` does not exist; {hint(name)}")
        elif name == anchor:
            yield Reason("is_anchor", f"`{name}` is the anchor, so it cannot move")
        elif twin.scene.object(name).fixed:
            yield Reason("fixed", f"`{name}` is fixed to the world, so it cannot move")
        elif anchor in twin.riders(name):
            yield Reason("carries_anchor", f"`{name}` supports the anchor `{anchor}`, so it cannot move around it")
        elif not words:
            yield Reason("no_predicate", f"no predicates between `{name}` and `{anchor}` are listed")


def _support(twin: Twin, anchor: str, axis: SceneAxis) -> Support | None:
    """Return the level surface on which objects stand around an anchor, or None if there is no such surface.

    This is the surface under the anchor. If there is no such surface and the anchor is fixed, it is the surface under
    most of the objects.
    """
    low = float(twin.shape(anchor, twin.state.poses[anchor]).extent(np.array([0.0, 0.0, 1.0]))[0])
    seen = [anchor]
    for name in seen:
        for other in twin.carried.get(name, ()):
            found = twin[other].support(low)
            if found is not None and abs(found.height - low) < 0.005:
                return found
    below = (below for name in axis.objects for below in twin.carried.get(name, ()))
    counts = Counter(name for name in below if name != anchor and name not in axis.objects)
    if twin.scene.object(anchor).fixed and (counts or twin.absent):
        return twin[counts.most_common(1)[0][0] if counts else twin.ground].support(None)
    return None


def _never(twin: Twin, axis: SceneAxis, anchor: str, support: Support | None, name: str, word: str) -> Iterator[Reason]:
    """Yield the reasons why a predicate can never hold between an object and the anchor."""
    if word in DROPPED:
        try:
            twin.judge(f"{word}({name}, {anchor})", twin.state)
        except PredicateError as error:
            yield Reason("impossible", f"{word}({name}, {anchor}) can never hold: {error}")
            return
        if word == "Inside":
            yield from _too_large(twin, axis, name, anchor)
        return
    assert support is not None
    thing = Placeable.of(twin, name, support.name, axis.objects)
    side = side_axis(twin.scene.viewer, word)
    shape = twin.shape(anchor, twin.state.poses[anchor])
    corners = np.column_stack([support.corners, np.zeros(len(support.corners))])
    wide = thing.outline.width
    if side is not None:
        low, high = shape.extent(side)
        end = float((corners @ side).max())
        needed = max((high - low) / 2, wide / 2) + wide / 2
        if end - (low + high) / 2 < needed:
            text = (
                f"`{name}` cannot be {SIDES[word]} `{anchor}`, because `{support.name}` extends only "
                f"{max(0.0, end - high):.3f} m beyond the anchor on that side, and `{name}` is {wide:.3f} m wide"
            )
            yield Reason("no_room", text, {"strip_deep_m": max(0.0, end - high), "width_m": wide})
            return
    farthest = _farthest(support, shape, side, wide)
    if axis.gap[0] > farthest:
        where = f"on `{support.name}`" + ("" if side is None else f" {SIDES[word]} `{anchor}`")
        text = (
            f"`{name}` cannot be placed {where} with the minimum gap of {axis.gap[0]:g} m from `{anchor}`: the largest "
            f"possible gap is {max(0.0, farthest):.3f} m"
        )
        yield Reason("gap", text, {"gap_m": axis.gap[0], "farthest_m": farthest})


def _farthest(support: Support, anchor: Hulls, side: Array | None, wide: float) -> float:
    """Return an upper bound on the gap [m] between the anchor and an object that still fits on a support.

    The object's center must be at least half the object's width from the edge of the support. If a side is requested,
    the center must also be beyond the edge of the anchor on that side. The distance from the center to the anchor
    exceeds the gap by at least half the object's width.

    Args:
        support: The support.
        anchor: Convex parts of the anchor.
        side: Unit vector of the requested side, or None if any side is allowed.
        wide: Width of the object [m].

    Returns:
        The gap [m], or -1 if the object does not fit.
    """
    import shapely

    foot = shapely.polygons(hull(anchor.corners[:, :2]))
    room = shapely.polygons(support.corners).buffer(-wide / 2, join_style="mitre")
    if side is not None:
        low, high = anchor.extent(side)
        edge = (low + high) / 2 + max((high - low) / 2, wide / 2)
        across, far = np.array([-side[1], side[0]]), 1e3
        ends = ((1, 0), (-1, 0), (-1, 1), (1, 1))
        corners = [edge * side[:2] + far * (a * across + b * side[:2]) for a, b in ends]
        room = room.intersection(shapely.polygons(corners))
    if room.is_empty:
        return -1.0
    points = shapely.points(shapely.get_coordinates(room))
    return float(shapely.distance(points, foot).max()) - wide / 2 + CLEARANCE


def _too_large(twin: Twin, axis: SceneAxis, name: str, anchor: str) -> Iterator[Reason]:
    """Yield a reason if, in every orientation, too little of an object fits into the anchor's cavity."""
    bodies = Bodies(twin.scene)
    holes = [hole for form in bodies[anchor].forms if form is not None and (hole := cavity(form)) is not None]
    forms = [form for form in bodies[name].forms if form is not None]
    boxes = [cavity_extents(hole) for hole in holes]
    share = max((largest_share(forms, box) for box in boxes), default=0.0)
    if share == 1.0 or (share > SURE and _goes_in(twin, axis, name, anchor)):
        return
    sides = twin.shape(name).size(), max(boxes, key=np.prod)
    size, room = (" x ".join(f"{100 * v:.1f}" for v in np.sort(side)[::-1]) for side in sides)
    text = f"`{name}` ({size} cm) cannot be inside `{anchor}`, whose cavity is {room} cm: {ENCLOSED:.0%} of the "
    text += "object must be inside, but "
    if share <= SURE:
        text += f"at most {share:.0%} fits in any orientation"
    else:
        text += f"none of {DOUBTED * DROPS} drops in different orientations achieved this"
    yield Reason("too_large", text, {"share": share})


def _goes_in(twin: Twin, axis: SceneAxis, name: str, anchor: str) -> bool:
    """Return True if at least one of many drops places an object inside the anchor.

    The object may also be only partly inside.
    """
    rng = np.random.default_rng(0)  # use a fixed seed, because the result must not depend on the candidate
    for _ in range(DOUBTED):
        table = Arrangement(twin, {}, (name,))
        if drop(table, anchor, Placeable.of(twin, name, anchor), ("Inside",), axis, rng) is None:
            return True
    return False


# Predicates for objects that stand beside the anchor on the same support, as phrases.
SIDES = {
    "LeftOf": "left of",
    "RightOf": "right of",
    "InFrontOf": "in front of",
    "Behind": "behind",
    "NextTo": "next to",
}

# Predicates for objects that are supported by the anchor, as phrases.
DROPPED = {"OnTop": "on", "Inside": "inside"}

# Pairs of predicates that cannot hold at once.
AGAINST = ({"LeftOf", "RightOf"}, {"InFrontOf", "Behind"})


def sets_of(allowed: Sequence[str], together: int) -> tuple[tuple[str, ...], ...]:
    """Return sets of up to ``together`` predicates that can hold at the same time.

    Each predicate is in at least one set, and the sets are as large as possible. A predicate that cannot be part of any
    set of the maximum size appears in the largest sets that can contain it.
    """
    words = tuple(dict.fromkeys(allowed))
    found: list[tuple[str, ...]] = []
    for size in range(min(together, len(words)), 0, -1):
        covered = {word for some in found for word in some}
        for some in combinations(words, size):
            if compatible(some) and (not found or len(found[0]) == size or not set(some) <= covered):
                found.append(some)
    return tuple(found)


def compatible(words: Iterable[str]) -> bool:
    """Return True if the given predicates can hold at the same time between the same two objects."""
    some = set(words)
    if any(pair <= some for pair in AGAINST):
        return False
    return not (some & set(SIDES) and some & set(DROPPED))


def side_axis(viewer: Pose | None, word: str) -> Array | None:
    """Return the horizontal unit vector toward the side that a predicate requests.

    Returns:
        Array of shape (3,), or None if the predicate does not request a side.
    """
    if word not in AXES:
        return None
    column, sign = AXES[word]
    return sign * viewer_axis(viewer, column)


# Maximum fraction of a table's area that shadows can fill if objects are placed at random, largest first. Disks or
# squares of equal size reach 0.55 (the jamming limit of random sequential packing). Mixtures of large and small objects
# fill slightly more.
FULL = 0.85


def too_full(
    twin: Twin,
    places: Sequence[Support],
    axis: SceneAxis | None,
    items: Sequence[library.LibraryItem] = (),
    count: int = 0,
    around: str = "",
) -> tuple[Reason, ...]:
    """Return the reasons why objects cannot all fit on the given surfaces, or an empty tuple if they might fit.

    Args:
        twin: The twin. Objects that the axis does not move stay in place.
        places: Level surfaces on which the objects must stand.
        axis: The scene axis that moves objects, or None.
        items: Distractors to choose from. All of them are used before any distractor is repeated.
        count: Number of distractors. The smallest distractors are assumed, as the best case.
        around: Name of the object onto which the axis moves objects. The default is the owner of one of ``places``.
    """
    moves = axis.objects if axis is not None else {}
    names = list(dict.fromkeys(place.name for place in places))
    here = {n for n, words in moves.items() if not set(words) & set(DROPPED)} if around in ("", *names) else set()
    here |= {n for n, below in twin.carried.items() if len(below) == 1 and below[0] in names and n not in moves}
    area = sum(place.area for place in places)
    taken = sum(twin.outline(n, twin.upright(n, names[0])).area for n in sorted(here))
    added = _least(twin, names[0], items, count, FULL * area - taken)
    if taken + added <= FULL * area:
        return ()
    what = f"{len(here)} objects" + (f" and the {count} smallest distractors" if count else "")
    is_full, its = ("is", "its") if len(names) == 1 else ("are", "their")
    text = (
        f"{' and '.join(f'`{name}`' for name in names)} {is_full} too full: the shadows of {what} require "
        f"{taken + added:.3f} m^2, but random placement can fill at most {FULL:.0%} of {its} {area:.3f} m^2"
    )
    numbers = {"needed_m2": taken + added, "support_m2": area, "things": float(len(here) + count)}
    return (Reason("too_full", text, numbers),)


def _least(twin: Twin, on: str, items: Sequence[library.LibraryItem], count: int, free: float) -> float:
    """Return a lower bound on the total shadow area [m^2] of ``count`` distractors chosen from ``items``.

    All items are used before any item is repeated. If the bounding rectangles fit into the ``free`` area [m^2], the
    exact shadows are not computed, and the result is 0.
    """
    if not count or _sum([item.size[0] * item.size[1] for item in items], count) <= free:
        return 0.0
    things = [replace(library.lowered(item.file), name=f"distractor_{k}") for k, item in enumerate(items)]
    more = twin.extended(things)
    return _sum([more.outline(t.name, more.upright(t.name, on)).area for t in things], count)


def _sum(areas: Sequence[float], count: int) -> float:
    """Return the sum of ``count`` areas, cycling through the list.

    If the last cycle is incomplete, it uses the smallest areas.
    """
    whole, rest = divmod(count, len(areas))
    return whole * sum(areas) + sum(sorted(areas)[:rest])
