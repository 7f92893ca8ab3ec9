"""Where a sketch puts what has a ``place``: exact in the plane, and at the height of its carrier's pieces below it.

Lowering solves places on the real shapes; this is the same rule on the pieces of a sketch. Inside a thing with a roof,
as a cabinet, the height is a guess.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace

from simfoundry.lint.convex import Piece
from simfoundry.lint.frames import Frame, Vec, rotation_of
from simfoundry.lint.things import Thing, bounds, extent, landing_on, middle
from simfoundry.spec.models.place import Place

CLEARANCE = 1e-4
"""How far above its carrier a thing is put [m]; as in lowering."""

SIDES = {"left_of": (1, 1), "right_of": (1, -1), "behind": (0, 1), "in_front_of": (0, -1)}
"""The axis of the viewer's frame (0 away, 1 left) that a word fixes, and the side of the anchor on it."""


def place_all(things: Mapping[str, Thing], places: Mapping[str, Place], viewer: Frame) -> dict[str, Thing]:
    """All things, those with a place there; each comes after those that its place names."""
    done = {name: thing for name, thing in things.items() if name not in places}
    for name in _order(places):
        done[name] = _placed(things[name], places[name], done, viewer)
    return {name: done[name] for name in things}


def _order(places: Mapping[str, Place]) -> Iterator[str]:
    """The names of places, each after those that it needs."""
    waiting: dict[str, set[str]] = {}
    wanted: dict[str, list[str]] = {}
    for name, place in places.items():
        waiting[name] = _needs(place) & places.keys()
        for other in waiting[name]:
            wanted.setdefault(other, []).append(name)
    ready = [name for name in places if not waiting[name]]
    while ready:
        name = ready.pop(0)
        yield name
        for other in wanted.get(name, ()):
            waiting[other].discard(name)
            if not waiting[other]:
                ready.append(other)


def _needs(place: Place) -> set[str]:
    named = (place.on, place.inside, place.left_of, place.right_of, place.in_front_of, place.behind)
    return {name.partition(".")[0] for name in named if name is not None}


def _placed(thing: Thing, place: Place, done: Mapping[str, Thing], viewer: Frame) -> Thing:
    name, _, link = (place.on or place.inside or "").partition(".")
    carrier = done[name]
    upright = thing.at(Frame(rotation_of(place.rpy_deg, place.yaw_deg)))
    if not upright.usable or not carrier.usable:
        return replace(upright, carrier=place.on or place.inside or "", exact=False)
    x, y = _position(upright, place, carrier, link, done, viewer)
    held = upright.at(Frame(upright.X_WO.r, (x, y, 0.0)))
    raised = landing_on(held, carrier.pieces_of(link))
    z = carrier.high[2] - held.low[2] if raised is None else raised
    exact = raised is not None and thing.sure and carrier.sure and carrier.exact and place.inside is None
    X_WO = Frame(upright.X_WO.r, (x, y, z + CLEARANCE))
    inside = place.inside is not None
    return replace(upright, X_WO=X_WO, carrier=place.on or place.inside or "", inside=inside, exact=exact)


def _position(
    upright: Thing, place: Place, carrier: Thing, link: str, done: Mapping[str, Thing], viewer: Frame
) -> tuple[float, float]:
    """Where the frame of a thing goes in the plane [m]; ``upright`` has it at the origin."""
    if place.xy is not None:
        return place.xy
    if place.local_xy is not None:
        x, y, _ = carrier.limb_frame(link).apply((*place.local_xy, 0.0))
        return x, y
    own = _middle(upright.hulls, upright.X_WO)
    words = [(word, getattr(place, word)) for word in SIDES if getattr(place, word) is not None]
    if not words:
        x, y, _ = _middle(carrier.part(link), carrier.limb_frame(link))
        return x - own[0], y - own[1]
    axes = (viewer.axis(0), viewer.axis(1))
    along: dict[int, float] = {}
    for word, name in words:
        axis, side = SIDES[word]
        anchor, n = done[name], axes[axis]
        (low, high), (mine_low, mine_high) = extent(anchor.hulls, n), extent(upright.hulls, n)
        along[axis] = high + place.gap - mine_low if side > 0 else low - place.gap - mine_high
        if len(words) == 1:
            there = _middle(anchor.hulls, anchor.X_WO)
            across = axes[1 - axis]
            along[1 - axis] = sum(a * (t - o) for a, t, o in zip(across, there, own, strict=True))
    (ax, ay, _), (lx, ly, _) = axes
    return along[0] * ax + along[1] * lx, along[0] * ay + along[1] * ly


def _middle(pieces: tuple[Piece, ...], X_WF: Frame) -> Vec:
    """The middle of the bounds of pieces along the axes of a frame, in the world."""
    spans = [extent(pieces, X_WF.axis(k)) for k in range(3)]
    if not all(math.isfinite(v) for span in spans for v in span):
        return middle(*bounds(pieces))
    mid = [(low + high) / 2 for low, high in spans]
    x, y, z = (sum(mid[k] * X_WF.axis(k)[i] for k in range(3)) for i in range(3))
    return x, y, z
