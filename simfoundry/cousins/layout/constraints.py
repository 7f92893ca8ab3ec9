"""What a recipe asks of a twin, and what of that can never be: found before anything is tried."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from types import MappingProxyType

import numpy as np

from simfoundry.cousins.layout.arrangement import Placeable
from simfoundry.cousins.layout.supports import Support, hull
from simfoundry.cousins.layout.twin import Twin
from simfoundry.cousins.recipe import library
from simfoundry.cousins.recipe.candidate import ImpossibleError, Reason
from simfoundry.geometry.frames import Array, Pose
from simfoundry.geometry.hulls import Hulls
from simfoundry.predicates import PredicateError
from simfoundry.predicates.judging.thresholds import ENCLOSED
from simfoundry.predicates.sides import viewer_axis
from simfoundry.scene.place import CLEARANCE
from simfoundry.spec.diagnostics import nearest
from simfoundry.spec.models.cousins import SceneAxis
from simfoundry.spec.models.expressions import parse_call, texts

DOUBTED = 2
"""What may fit with a part of it only is dropped so many times as often as a candidate does before it is refused: what
comes in once in fifty drops is missed in 8 of 100 asks, and no recipe could live on it."""


@dataclass(frozen=True, eq=False)
class PlacementConstraints:
    """An axis made ready: the anchor, on what things stand around it, in which ``order`` they are placed, and the
    ``sets`` of predicates that each may have at once."""

    anchor: str
    support: Support | None
    order: tuple[str, ...]
    sets: Mapping[str, tuple[tuple[str, ...], ...]]


def placement_constraints(twin: Twin, axis: SceneAxis) -> PlacementConstraints:
    """Return what an axis asks; raises :class:`ImpossibleError` with every reason that is certain.

    Found once for a twin.
    """
    key = axis.model_dump_json()
    if key not in twin.constraints:
        twin.constraints[key] = _asks(twin, axis)
    found = twin.constraints[key]
    if isinstance(found, ImpossibleError):
        raise ImpossibleError(found.reasons)
    return found


def anchor_of(twin: Twin, axis: SceneAxis) -> str:
    """The anchor: the one that is given, or what the goal is about and stays; empty where there is none."""
    if axis.anchor is not None:
        return axis.anchor
    about: list[str] = []
    for text, _ in texts(twin.goal) if twin.goal is not None else ():
        args = [a.partition(".")[0] for a in parse_call(text).args]
        about += args[1:2] + args[:1]
    names = {o.name for o in twin.scene.objects}
    return next((n for n in about if n in names and n not in axis.objects), "")


def _asks(twin: Twin, axis: SceneAxis) -> PlacementConstraints | ImpossibleError:
    reasons = list(_wrong_names(twin, axis))
    if reasons:
        return ImpossibleError(tuple(reasons))
    anchor = anchor_of(twin, axis)
    sets = {name: sets_of(words, axis.relations_per_object) for name, words in axis.objects.items()}
    beside = any(word in SIDES for words in axis.objects.values() for word in words)
    support = _support(twin, anchor, axis) if beside else None
    if beside and support is None:
        text = f"nothing level carries `{anchor}`, so nothing can stand beside it; it rests on "
        text += ", ".join(f"`{n}`" for n in twin.carried.get(anchor, ())) or "nothing"
        return ImpossibleError((Reason("no_support", text),))
    for name, words in axis.objects.items():
        reasons += _contradiction(sets[name], name, words, axis.relations_per_object)
        for word in dict.fromkeys(words):
            reasons += _never(twin, axis, anchor, support, name, word)
    if support is not None and not reasons:
        reasons += too_full(twin, (support,), axis)
    if reasons:
        return ImpossibleError(tuple(reasons))
    on = support.name if support is not None else anchor
    areas = {name: twin.outline(name, twin.upright(name, on)).area for name in axis.objects}
    order = tuple(sorted(areas, key=lambda name: (-round(areas[name], 9), name)))
    return PlacementConstraints(anchor, support, order, MappingProxyType(sets))


def _wrong_names(twin: Twin, axis: SceneAxis) -> Iterator[Reason]:
    names = {o.name for o in twin.scene.objects}
    anchor = anchor_of(twin, axis)
    if not anchor:
        yield Reason("no_anchor", "there is no anchor: no goal says what the task is about; name one as `anchor`")
    elif anchor not in names:
        hint = nearest(anchor, names) or f"there are {', '.join(sorted(names))}"
        yield Reason("no_anchor", f"the anchor `{anchor}` does not exist; {hint}")
    for name, words in axis.objects.items():
        if name not in names:
            hint = nearest(name, names) or f"there are {', '.join(sorted(names))}"
            yield Reason("no_object", f"`{name}` does not exist; {hint}")
        elif name == anchor:
            yield Reason("is_anchor", f"`{name}` is the anchor, which stays; it cannot move as well")
        elif twin.scene.object(name).fixed:
            yield Reason("fixed", f"`{name}` is fixed to the world, so it cannot move")
        elif anchor in twin.riders(name):
            yield Reason("carries_anchor", f"`{name}` carries the anchor `{anchor}`, so it cannot move around it")
        elif not words:
            yield Reason("no_predicate", f"`{name}` has no predicate that it may have to `{anchor}`")


def _support(twin: Twin, anchor: str, axis: SceneAxis) -> Support | None:
    """Return what things stand on around an anchor: the level under it; under one that is fixed, that of the things."""
    low = float(twin.shape(anchor, twin.state.poses[anchor]).extent(np.array([0.0, 0.0, 1.0]))[0])
    seen = [anchor]
    for name in seen:
        for below in twin.carried.get(name, ()):
            found = twin[below].support(low)
            if found is not None and abs(found.height - low) < 0.005:
                return found
    counts: dict[str, int] = {}
    for name in axis.objects:
        for below in twin.carried.get(name, ()):
            if below != anchor and below not in axis.objects:
                counts[below] = counts.get(below, 0) + 1
    if twin.scene.object(anchor).fixed and (counts or twin.absent):
        return twin[max(counts, key=lambda n: counts[n]) if counts else twin.ground].support(None)
    return None


def _never(twin: Twin, axis: SceneAxis, anchor: str, support: Support | None, name: str, word: str) -> Iterator[Reason]:
    """Yield why a predicate can never hold between an object and the anchor."""
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
                f"nothing as large as `{name}` can be {SIDES[word]} `{anchor}`: `{support.name}` ends "
                f"{max(0.0, end - high):.3f} m beyond it there, and `{name}` is {wide:.3f} m wide"
            )
            numbers = {"strip_deep_m": max(0.0, end - high), "width_m": wide}
            yield Reason("no_room", text, MappingProxyType(numbers))
            return
    farthest = _farthest(support, shape, side, wide)
    if axis.gap[0] > farthest:
        where = f"on `{support.name}`" + ("" if side is None else f" {SIDES[word]} `{anchor}`")
        text = (
            f"no place {where} is {axis.gap[0]:g} m from `{anchor}`, as the least gap asks: `{name}` finds room for "
            f"{max(0.0, farthest):.3f} m at most"
        )
        yield Reason("gap", text, MappingProxyType({"gap_m": axis.gap[0], "farthest_m": farthest}))


def _farthest(support: Support, anchor: Hulls, side: Array | None, wide: float) -> float:
    """The widest gap [m] to the anchor at which something ``wide`` [m] has room on a support, on one side or on any.

    Its middle is half its width within the edge, and beyond the edge of the anchor where a side is asked for; so much
    nearer than its middle is it to the anchor at least.
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
    """Return whether most of a thing is outside of the cavity, however it is turned."""
    from simfoundry.cousins.layout.drop_sampling import DROPS, SURE, cavity_extents, largest_share
    from simfoundry.geometry.cavity import cavity
    from simfoundry.predicates.judging.bodies import Bodies

    bodies = Bodies(twin.scene)
    holes = [hole for form in bodies[anchor].forms if form is not None and (hole := cavity(form)) is not None]
    forms = [form for form in bodies[name].forms if form is not None]
    boxes = [cavity_extents(hole) for hole in holes]
    share = max((largest_share(forms, box) for box in boxes), default=0.0)
    if share == 1.0 or (share > SURE and _goes_in(twin, axis, name, anchor)):
        return
    size = " x ".join(f"{100 * v:.1f}" for v in np.sort(twin.shape(name).size())[::-1])
    room = " x ".join(f"{100 * v:.1f}" for v in np.sort(max(boxes, key=np.prod))[::-1])
    text = f"`{name}` ({size} cm) cannot be inside `{anchor}`, whose cavity is {room} cm: {ENCLOSED:.0%} of it must be"
    text += ", and "
    if share <= SURE:
        text += f"{share:.0%} would be at most, however it is turned"
    else:
        text += f"in {DOUBTED * DROPS} drops, in all orientations, it never was"
    yield Reason("too_large", text, MappingProxyType({"share": share}))


def _goes_in(twin: Twin, axis: SceneAxis, name: str, anchor: str) -> bool:
    """Return whether an object with no room in the cavity as a whole comes to lie there in enough drops."""
    from simfoundry.cousins.layout.arrangement import Arrangement
    from simfoundry.cousins.layout.drop_sampling import drop

    rng = np.random.default_rng(0)  # the answer belongs to the ask, not to a candidate
    for _ in range(DOUBTED):
        table = Arrangement(twin, {}, (name,))
        if drop(table, anchor, Placeable.of(twin, name, anchor), ("Inside",), axis, rng) is None:
            return True
    return False


def _contradiction(sets: tuple[tuple[str, ...], ...], name: str, words: tuple[str, ...], together: int) -> list[Reason]:
    """Return why no predicates that are asked for can hold at once; nothing where some can."""
    several = min(together, len(set(words)))
    if len(sets[0]) >= several:
        return []
    listed = ", ".join(dict.fromkeys(words))
    text = f"no {several} of {listed} can hold for `{name}` at once, as `relations_per_object` asks"
    return [Reason("contradiction", text, MappingProxyType({"together": float(several)}))]


SIDES = {
    "LeftOf": "left of",
    "RightOf": "right of",
    "InFrontOf": "in front of",
    "Behind": "behind",
    "NextTo": "next to",
}
"""Predicates of things that stand on one support, in words."""

DROPPED = {"OnTop": "on", "Inside": "inside"}
"""Predicates of what the anchor carries."""

AGAINST = ({"LeftOf", "RightOf"}, {"InFrontOf", "Behind"})

_WAYS = {"LeftOf": (1, 1.0), "RightOf": (1, -1.0), "Behind": (0, 1.0), "InFrontOf": (0, -1.0)}


def sets_of(allowed: Sequence[str], together: int) -> tuple[tuple[str, ...], ...]:
    """The sets of predicates that can hold at once, of the largest size up to ``together``, so that each is in one.

    A predicate that fits in none of that size comes in its largest.
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
    """Return whether predicates of the same two things can hold at once."""
    some = set(words)
    if any(pair <= some for pair in AGAINST):
        return False
    return not (some & set(SIDES) and some & set(DROPPED))


def side_axis(viewer: Pose | None, word: str) -> Array | None:
    """The level unit vector, shape (3,), that a side means; None for a word that means none."""
    if word not in _WAYS:
        return None
    column, sign = _WAYS[word]
    return sign * viewer_axis(viewer, column)


FULL = 0.85
"""Shadows fill no more of a table than this where things are put by chance, largest first: discs or squares of one
size come to 0.55 (the jamming limit of random sequential packing), and small ones between large ones to some more."""


def too_full(
    twin: Twin,
    places: Sequence[Support],
    axis: SceneAxis | None,
    items: Sequence[library.LibraryItem] = (),
    count: int = 0,
    around: str = "",
) -> tuple[Reason, ...]:
    """Return why not everything that must stand on some places finds room there; nothing where it may.

    They must hold what stands there and stays, what the ``axis`` moves onto ``around`` (by default the places), and
    ``count`` distractors, which are the ``items`` in turn: the smallest of them, at best.
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
    what = f"{len(here)} things" + (f" and the {count} smallest distractors" if count else "")
    is_full, has = ("is", "it has") if len(names) == 1 else ("are", "they have")
    text = (
        f"{' and '.join(f'`{name}`' for name in names)} {is_full} too full: the shadows of {what} take "
        f"{taken + added:.3f} m^2, {has} {area:.3f} m^2, and what is put by chance fills {FULL:.0%} of that at most"
    )
    numbers = {"needed_m2": taken + added, "support_m2": area, "things": float(len(here) + count)}
    return (Reason("too_full", text, MappingProxyType(numbers)),)


def _least(twin: Twin, on: str, items: Sequence[library.LibraryItem], count: int, free: float) -> float:
    """The shadows [m^2] of ``count`` of the items together, none taken twice before each was once: at least that.

    Where even the rectangles around them fit into what is ``free`` [m^2], they are not looked at closer.
    """
    if not count or _sum([item.size[0] * item.size[1] for item in items], count) <= free:
        return 0.0
    things = [replace(library.lowered(item.file), name=f"distractor_{k}") for k, item in enumerate(items)]
    more = twin.extended(things)
    return _sum([more.outline(t.name, more.upright(t.name, on)).area for t in things], count)


def _sum(areas: Sequence[float], count: int) -> float:
    """The sum of ``count`` areas taken in turns, the smallest in the last one."""
    whole, rest = divmod(count, len(areas))
    return whole * sum(areas) + sum(sorted(areas)[:rest])
