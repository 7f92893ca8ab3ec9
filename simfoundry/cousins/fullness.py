"""A table too full: more shadows than it has room for, said before anything is tried."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import MappingProxyType

from simfoundry.cousins import library
from simfoundry.cousins.reasons import Reason
from simfoundry.cousins.sides import DROPPED
from simfoundry.cousins.support import Support
from simfoundry.cousins.twin import Twin
from simfoundry.spec.models.cousins import SceneAxis

FULL = 0.85
"""Shadows fill no more of a table than this where things are put by chance, largest first: discs or squares of one
size come to 0.55 (the jamming limit of random sequential packing), and small ones between large ones to some more."""


def too_full(
    twin: Twin,
    places: Sequence[Support],
    axis: SceneAxis | None,
    items: Sequence[library.Item] = (),
    count: int = 0,
    around: str = "",
) -> tuple[Reason, ...]:
    """Why not everything that must stand on some places finds room there; nothing where it may.

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


def _least(twin: Twin, on: str, items: Sequence[library.Item], count: int, free: float) -> float:
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
