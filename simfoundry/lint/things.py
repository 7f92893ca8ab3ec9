"""The things of a sketch: posed convex pieces, by object and link."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import NamedTuple

from simfoundry.lint.convex import CLOSE, Piece, apart, lift
from simfoundry.lint.frames import WORLD, Frame, Vec
from simfoundry.lint.solids import Solid, posed
from simfoundry.spec.models.base import FARTHEST


class Limb(NamedTuple):
    """A link of a thing: its frame in the thing, and its solids with their poses in it."""

    X_OL: Frame
    solids: tuple[tuple[Solid, Frame], ...]
    touches: bool = True


class Turn(NamedTuple):
    """A joint at its position, with its limits [m or rad]; a continuous joint has none, a ball or free one a motion.

    ``closed`` is the limit at which it counts as closed, where the document says so.
    """

    position: float
    limits: tuple[float, float] | None
    child: str
    motion: Frame = WORLD
    closed: str = ""


@dataclass(frozen=True, eq=False)
class Thing:
    """An object at its pose in the world.

    ``carrier`` is what its place names (``cabinet.drawer``), ``inside`` whether it lies in that. Where the pose is not
    ``exact``, its height is a guess.
    """

    name: str
    fixed: bool
    X_WO: Frame
    limbs: Mapping[str, Limb]
    joints: Mapping[str, Turn]
    carrier: str = ""
    inside: bool = False
    exact: bool = True

    def at(self, X_WO: Frame) -> Thing:
        """The same thing elsewhere."""
        return replace(self, X_WO=X_WO)

    def limb_frame(self, part: str) -> Frame:
        """The frame of a link, or of the link that a joint moves, in the world; of the thing where it has no such."""
        limb = self.limb(part)
        return self.X_WO if limb is None else self.X_WO @ limb.X_OL

    def limb(self, part: str) -> Limb | None:
        """A link by its own name, or by that of the joint that moves it."""
        if part in self.limbs:
            return self.limbs[part]
        return self.limbs.get(self.joints[part].child) if part in self.joints else None

    @cached_property
    def hulls(self) -> tuple[Piece, ...]:
        """The hull of each solid, in the world."""
        return tuple(
            solid.hull.moved(self.X_WO @ limb.X_OL @ X) for limb in self.limbs.values() for solid, X in limb.solids
        )

    @cached_property
    def touching(self) -> tuple[Piece, ...]:
        """The convex pieces that touch others, in the world; of a solid that is not sure, its hull."""
        return tuple(
            piece
            for limb in self.limbs.values()
            if limb.touches
            for solid, X in limb.solids
            for piece in posed(solid, self.X_WO @ limb.X_OL @ X)
        )

    @cached_property
    def sure(self) -> bool:
        """Whether the pieces are all that there is, not bounds of something hollow."""
        return all(solid.sure for limb in self.limbs.values() for solid, _ in limb.solids)

    @cached_property
    def solid(self) -> bool:
        """Whether anything of it touches others."""
        return any(limb.touches and limb.solids for limb in self.limbs.values())

    @cached_property
    def low(self) -> Vec:
        """The lower corner of its bounds in the world [m]."""
        return bounds(self.hulls)[0]

    @cached_property
    def high(self) -> Vec:
        """The upper corner of its bounds in the world [m]."""
        return bounds(self.hulls)[1]

    @property
    def middle(self) -> Vec:
        """The middle of its bounds in the world [m]."""
        return middle(self.low, self.high)

    @cached_property
    def usable(self) -> bool:
        """Whether it has a shape of a size that can be reckoned with."""
        return bool(self.hulls) and all(abs(v) < FARTHEST for v in (*self.low, *self.high))

    def part(self, link: str) -> tuple[Piece, ...]:
        """The hulls of one link in the world; of all where ``link`` is empty or unknown."""
        limb = self.limb(link) if link else None
        if limb is None:
            return self.hulls
        return tuple(solid.hull.moved(self.X_WO @ limb.X_OL @ X) for solid, X in limb.solids)

    def pieces_of(self, link: str) -> tuple[Piece, ...]:
        """The convex pieces of one link in the world; of all that touch where ``link`` is empty or unknown."""
        limb = self.limb(link) if link else None
        if limb is None:
            return self.touching
        return tuple(p for solid, X in limb.solids for p in posed(solid, self.X_WO @ limb.X_OL @ X))


DOWN: Vec = (0.0, 0.0, -1.0)


def bounds(pieces: tuple[Piece, ...]) -> tuple[Vec, Vec]:
    """The corners of the bounds of pieces; empty bounds where there is none."""
    if len(pieces) == 1:
        return pieces[0].low, pieces[0].high
    if not pieces:
        return (math.inf, math.inf, math.inf), (-math.inf, -math.inf, -math.inf)
    lx, ly, lz = zip(*(p.low for p in pieces), strict=True)
    hx, hy, hz = zip(*(p.high for p in pieces), strict=True)
    return (min(lx), min(ly), min(lz)), (max(hx), max(hy), max(hz))


def middle(low: Vec, high: Vec) -> Vec:
    """The middle of bounds."""
    return ((low[0] + high[0]) / 2, (low[1] + high[1]) / 2, (low[2] + high[2]) / 2)


def extent(pieces: tuple[Piece, ...], n: Vec) -> tuple[float, float]:
    """Lowest and highest value of ``n . p`` over pieces."""
    spans = [piece.extent(n) for piece in pieces]
    return min(low for low, _ in spans), max(high for _, high in spans)


def close_pairs(a: tuple[Piece, ...], b: tuple[Piece, ...], gap: float) -> Iterator[tuple[Piece, Piece]]:
    """Pairs of pieces whose bounds are at most ``gap`` apart, or with a negative one overlap by at least that."""
    around_a, around_b = (Piece((), low=low, high=high) for low, high in map(bounds, (a, b)))
    near = [q for q in b if not apart(q, around_a, gap)]
    for p in a:
        if not apart(p, around_b, gap):
            for q in near:
                if not apart(p, q, gap):
                    yield p, q


@lru_cache(maxsize=256)
def _flat_top(piece: Piece) -> tuple[tuple[float, float], ...]:
    """The corners of the top face of an upright box, counter-clockwise seen from above; none of anything else."""
    top = [p[:2] for p in piece.points if p[2] > piece.high[2] - 1e-9]
    if len(piece.points) != 8 or len(top) != 4 or piece.margin or piece.radii:
        return ()
    x, y = sum(p[0] for p in top) / 4, sum(p[1] for p in top) / 4
    return tuple(sorted(top, key=lambda p: math.atan2(p[1] - y, p[0] - x)))


def is_over(point: Vec, piece: Piece) -> bool:
    """Whether a point lies over the top face of an upright box; False of anything else, and beside it."""
    if not (piece.low[0] <= point[0] <= piece.high[0] and piece.low[1] <= point[1] <= piece.high[1]):
        return False
    top = _flat_top(piece)
    edges = zip(top, (*top[1:], *top[:1]), strict=True)
    return bool(top) and all(
        (b[0] - a[0]) * (point[1] - a[1]) - (b[1] - a[1]) * (point[0] - a[0]) >= 0 for a, b in edges
    )


def is_even(piece: Piece) -> bool:
    """Whether a piece is the same on either side of the middle of its points: it balances there."""
    n = len(piece.points)
    twice = tuple(2 * sum(p[k] for p in piece.points) / n for k in range(3))
    known = {tuple(round(v, 9) for v in p) for p in piece.points}
    mirrored = {tuple(round(t - v, 9) + 0.0 for t, v in zip(twice, p, strict=True)) for p in piece.points}
    return len(set(piece.radii)) <= 1 and {tuple(v + 0.0 for v in p) for p in known} == mirrored


def landing_on(thing: Thing, others: tuple[Piece, ...]) -> float | None:
    """The same as :func:`landing` for the pieces of a thing that touch; quick where it stands on one flat top."""
    if len(others) == 1:
        foot = min((hull.support(DOWN) for hull in thing.hulls), key=lambda p: p[2])
        if thing.solid and is_over(foot, others[0]):
            return others[0].high[2] - foot[2]
    return landing(thing.touching or thing.hulls, others)


def landing(a: tuple[Piece, ...], b: tuple[Piece, ...]) -> float | None:
    """How far pieces must be raised to lie on others from above [m], negative to fall; None beside them."""
    best: float | None = None
    pairs = [
        (q.high[2] - p.low[2], p, q)
        for p in a
        for q in b
        if p.low[0] <= q.high[0] and q.low[0] <= p.high[0] and p.low[1] <= q.high[1] and q.low[1] <= p.high[1]
    ]
    pairs.sort(key=lambda pair: -pair[0])
    for most, p, q in pairs:
        if best is not None and most <= best + CLOSE:
            break
        raised = lift(p, q)
        if raised is not None and (best is None or raised > best):
            best = raised
    return best
