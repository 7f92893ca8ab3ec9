"""Places that cannot be solved (SF210), as far as a sketch is certain of it; lowering finds the others.

What is said of one is what lowering (:mod:`simfoundry.scene.place`) says of it.
"""

from __future__ import annotations

from collections.abc import Iterator

from simfoundry.lint.report import MOST
from simfoundry.lint.sketch import Sketch
from simfoundry.lint.things import Thing, bounds
from simfoundry.spec.diagnostics import Diagnostic
from simfoundry.spec.loaded import Loaded


def misplaced(loaded: Loaded, drawn: Sketch) -> Iterator[Diagnostic]:
    """SF210: things that are beside what shall carry them, or in what has no hollow."""
    assert loaded.document is not None
    found = 0
    for thing in drawn.things.values():
        name, _, link = thing.carrier.partition(".")
        carrier = drawn.things.get(name)
        if carrier is None or not thing.usable or not carrier.usable or found >= MOST:
            continue
        wrong = _beside(thing, carrier, link) or (_without_hollow(thing, carrier, link) if thing.inside else None)
        if wrong is not None:
            found += 1
            yield loaded.document.finding("SF210", ("objects", thing.name, "place"), *wrong)


def _beside(thing: Thing, carrier: Thing, link: str) -> tuple[str, str] | None:
    """What to say of a thing that falls past its carrier, whose bounds it does not even meet."""
    pieces = carrier.pieces_of(link)
    if not pieces:
        return None
    low, high = bounds(pieces)
    if all(thing.low[k] <= high[k] and low[k] <= thing.high[k] for k in range(2)):
        return None
    spans = " and ".join(f"{'xy'[k]} {_metres(low[k])} to {_metres(high[k])}" for k in range(2))
    spot = ", ".join(_metres(v) for v in thing.X_WO.p[:2])
    message = f"`{thing.name}` at ({spot}) is not above `{thing.carrier}`, which spans {spans}"
    return message, f"move it over `{thing.carrier}`"


def _without_hollow(thing: Thing, carrier: Thing, link: str) -> tuple[str, str] | None:
    """What to say of a thing inside a single convex piece."""
    if not carrier.sure or len(carrier.pieces_of(link)) != 1:
        return None
    message = f"`{thing.name}` cannot be inside `{thing.carrier}`, whose colliders are one convex part without a hollow"
    return message, "write `on`, or give it a hollow: a lathe, a mesh with `collision: decompose`, parts"


def _metres(value: float) -> str:
    return f"{value:.3f}" if abs(value) < 1e4 else f"{value:.3g}"
