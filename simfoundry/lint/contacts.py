"""Things that overlap (SF410), and things that nothing carries (SF411)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from simfoundry.lint.convex import CLOSE, Piece, apart, lift, penetration
from simfoundry.lint.report import MOST, warning, where
from simfoundry.lint.sketch import Sketch
from simfoundry.lint.things import DOWN, Thing, close_pairs, is_over, landing_on
from simfoundry.scene.lengths import length, number
from simfoundry.spec.diagnostics import Diagnostic
from simfoundry.spec.loaded import Loaded

DEEP = 0.002
"""Things that interpenetrate by no more than this [m] come apart by themselves; captured ones do as much."""

HOVERING = 0.005
"""What hangs lower than this over its support [m] comes down without a bounce that matters."""

STEEPEST = 1.5
"""What comes free when it is raised by no more than this many times the depth has sunk in from above."""

MOST_PAIRS = 20_000
"""Pairs of things that are near one another and are looked at in one scene; only a heap without order has as many."""

MOST_MEASURED = 6_000
"""Pairs of pieces that are measured for one scene, which takes two seconds; 1,000 things on a table need some hundreds.
What lies beyond is looked at once the first findings are mended."""


# -- overlap --------------------------------------------------------------------------------------------------------


def overlaps(loaded: Loaded, drawn: Sketch) -> Iterator[Diagnostic]:
    """SF410: pairs of things that interpenetrate, unless both are fixed, or shall pass through each other."""
    found = measured = 0
    silent = {frozenset(pair) for pair in drawn.spec.no_contact}
    for a, b in _neighbours([t for t in drawn.things.values() if t.usable and t.solid and t.sure]):
        if _left_alone(a, b) or frozenset((a.name, b.name)) in silent:
            continue
        pairs = list(close_pairs(a.touching, b.touching, -DEEP))
        measured += len(pairs)
        if measured > MOST_MEASURED:
            return
        depth = deepest(pairs)
        if depth > DEEP:
            yield _overlap(loaded, a, b, depth)
            found += 1
            if found >= MOST:
                return


def deepest(pairs: Iterable[tuple[Piece, Piece]]) -> float:
    """How deep pieces interpenetrate at most [m]; no more than ``DEEP`` where it is less."""
    return max((penetration(p, q, DEEP) for p, q in pairs), default=0.0)


def _left_alone(a: Thing, b: Thing) -> bool:
    """Whether it is not certain enough how two things lie to one another."""
    if a.fixed and b.fixed:
        return True
    carriers = [t.carrier.partition(".")[0] for t in (a, b)]
    if a.name in carriers or b.name in carriers:
        return True
    together = a.inside and b.inside and a.carrier == b.carrier
    return not (a.exact and b.exact) and not together


def _overlap(loaded: Loaded, a: Thing, b: Thing, depth: float) -> Diagnostic:
    """The finding at what can be moved, of two the later."""
    moved, other = (a, b) if b.fixed else (b, a)
    message = f"`{moved.name}` and `{other.name}` overlap by {length(depth)}"
    raised = landing_on(moved, other.touching)
    hint = "move one of them away from the other"
    if raised is not None and 0 < raised <= STEEPEST * depth:
        hint = f"raise `{moved.name}` by {length(raised)}, to z = {number(moved.X_WO.p[2] + raised)}"
    if len(where(loaded, moved.name)) == 2:
        hint = f"it has no `place` and no `pose`, so it is at the origin: write `place: {{on: {other.name}}}`"
    hint += f"; what shall be like this is `allow: {{SF410: {{{moved.name}: why}}}}`"
    return warning(loaded, "SF410", where(loaded, moved.name), message, hint, (other.name,))


def _neighbours(things: Sequence[Thing]) -> Iterator[tuple[Thing, Thing]]:
    """Pairs whose bounds overlap by more than ``DEEP``, found by sweeping along x."""
    order = sorted(range(len(things)), key=lambda k: (things[k].low[0], k))
    seen = 0
    live: list[tuple[float, int, Piece]] = []
    for k in order:
        thing = things[k]
        box = Piece((), low=thing.low, high=thing.high)
        reach = thing.low[0] + DEEP
        live = [item for item in live if item[0] > reach]
        for _, j, other in live:
            if not apart(box, other, -DEEP):
                yield (things[j], thing) if j < k else (thing, things[j])
                seen += 1
                if seen >= MOST_PAIRS:
                    return
        live.append((thing.high[0], k, box))


# -- support --------------------------------------------------------------------------------------------------------


def unsupported(loaded: Loaded, drawn: Sketch) -> Iterator[Diagnostic]:
    """SF411: free things that would fall, in a scene where something is fixed and gravity points down."""
    gx, gy, gz = drawn.spec.gravity
    things = [t for t in drawn.things.values() if t.usable and t.solid]
    if gx or gy or gz >= 0 or not any(t.fixed for t in things):
        return
    found = asked = 0
    carriers = _Carriers(things)
    for thing in things:
        if thing.fixed or thing.carrier:
            continue
        carried = False
        for other in carriers.near(thing):
            asked += 1
            carried = carries(thing, other)
            if carried:
                break
        if asked > MOST_MEASURED + 8 * len(things):  # a wall of bricks has eight neighbours each, and is no heap
            return
        if carried:
            continue
        yield _falling(loaded, thing, [t for t in things if t is not thing])
        found += 1
        if found >= MOST:
            return


def carries(thing: Thing, other: Thing) -> bool:
    """Whether a thing meets another at once or on the first ``HOVERING`` of its way down.

    Of what is only known by its bounds, it is enough to be near those.
    """
    for hull in thing.hulls:
        foot = hull.support(DOWN)
        if len(other.hulls) == 1 and abs(foot[2] - other.high[2]) <= HOVERING and is_over(foot, other.hulls[0]):
            return True
    if not (other.sure and other.exact and thing.sure):
        return any(True for _ in close_pairs(thing.hulls, other.hulls, HOVERING))
    return any(_meets(p, q) for p, q in close_pairs(thing.touching, other.touching, HOVERING))


def _meets(p: Piece, q: Piece) -> bool:
    """Whether p meets q on its way down, and q is no lid: p would rather have to be lowered than raised to pass it.

    What is stuck in q is not said to fall: that the two overlap is finding enough.
    """
    raised = lift(p, q)
    if raised is None or raised < -HOVERING - CLOSE:
        return False
    below = lift(p, q, -1.0)
    return (below is not None and below + raised < 0) or penetration(p, q, DEEP) > DEEP


class _Carriers:
    """What may carry a thing: all that is large, and what is small in its neighbourhood."""

    CELL = 0.25
    """Side of the cells that the plane is cut into [m]: a little more than most things on a table measure."""

    MOST_CELLS = 16
    """What covers more cells is large, and looked at for everything."""

    def __init__(self, things: Sequence[Thing]) -> None:
        self.large: list[Thing] = []
        self.cells: dict[tuple[int, int], list[Thing]] = {}
        for thing in things:
            cells = self._cells(thing)
            if cells is None:
                self.large.append(thing)
                continue
            for cell in cells:
                self.cells.setdefault(cell, []).append(thing)

    def near(self, thing: Thing) -> Iterator[Thing]:
        """The things whose bounds are no farther than ``HOVERING`` from those of ``thing``, the large ones first."""
        box = Piece((), low=thing.low, high=thing.high)
        cells = self._cells(thing)
        small = (
            [t for k in self.cells.values() for t in k]
            if cells is None
            else [t for cell in cells for t in self.cells.get(cell, ())]
        )
        for other in (*self.large, *dict.fromkeys(small)):
            if other is not thing and not apart(box, Piece((), low=other.low, high=other.high), HOVERING):
                yield other

    def _cells(self, thing: Thing) -> list[tuple[int, int]] | None:
        """The cells that a thing covers; None of a large one."""
        gap = HOVERING
        x0, y0 = (int((thing.low[k] - gap) // self.CELL) for k in range(2))
        x1, y1 = (int((thing.high[k] + gap) // self.CELL) for k in range(2))
        if (x1 - x0 + 1) * (y1 - y0 + 1) > self.MOST_CELLS:
            return None
        return [(x, y) for x in range(x0, x1 + 1) for y in range(y0, y1 + 1)]


def _falling(loaded: Loaded, thing: Thing, others: Sequence[Thing]) -> Diagnostic:
    """The finding, with how far it falls, and onto what."""
    below: list[tuple[float, str]] = []
    for other in sorted(others, key=lambda t: -t.high[2]):
        if below and other.high[2] - thing.low[2] < max(below)[0]:
            break  # nothing that ends lower can stop it earlier
        if other.low[2] < thing.low[2] and not _beside(thing, other):
            raised = landing_on(thing, other.touching)
            if raised is not None and raised < 0:
                below.append((raised, other.name))
    path = where(loaded, thing.name)
    if not below:
        message = f"nothing carries `{thing.name}`, and there is nothing below it"
        hint = "put it on something with `place`, or weld it to the world with `fixed: true`"
        return warning(loaded, "SF411", path, message, hint)
    raised, name = max(below)
    message = f"nothing carries `{thing.name}`: it falls {length(-raised)} onto `{name}`"
    hint = f"at z = {number(thing.X_WO.p[2] + raised)} it stands there; or write `place: {{on: {name}, ...}}`"
    return warning(loaded, "SF411", path, message, hint, (name,))


def _beside(a: Thing, b: Thing) -> bool:
    return any(a.low[k] > b.high[k] or b.low[k] > a.high[k] for k in range(2))
