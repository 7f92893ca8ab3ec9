"""Things that are out of every camera's view (SF409)."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator

from simfoundry.lint.frames import Vec
from simfoundry.lint.report import MOST, Path_, warning, where
from simfoundry.lint.sketch import Eye, Sketch
from simfoundry.lint.things import Thing
from simfoundry.spec.diagnostics import Diagnostic
from simfoundry.spec.loaded import Loaded


def unseen(loaded: Loaded, drawn: Sketch) -> Iterator[Diagnostic]:
    """SF409 in a scene: free things of which no camera sees anything, even if nothing hides them."""
    free = [thing for thing in drawn.things.values() if not thing.fixed]
    yield from unseen_of(loaded, drawn, free, lambda name: where(loaded, name))


def unseen_of(
    loaded: Loaded, drawn: Sketch, things: Iterable[Thing], path_of: Callable[[str], Path_]
) -> Iterator[Diagnostic]:
    """SF409 of some things, each at its path; cameras that a robot carries look elsewhere in time."""
    if not drawn.eyes:
        return
    found = 0
    for thing in things:
        if not thing.usable or found >= MOST or any(sees(eye, thing) for eye in drawn.eyes.values()):
            continue
        found += 1
        angle, name = min((off_axis(eye, thing.middle), name) for name, eye in drawn.eyes.items())
        only = len(drawn.eyes) == 1
        message = f"`{thing.name}` is out of the view of " + (f"`{name}`" if only else "every camera")
        hint = f"it is {angle:.0f} deg off the axis of `{name}`, which sees {half_angle(drawn.eyes[name]):.0f} deg"
        yield warning(
            loaded, "SF409", path_of(thing.name), message, f"{hint} to the corners of its picture; move one of the two"
        )


def sees(eye: Eye, thing: Thing) -> bool:
    """Whether any of the bounds of a thing may be in the picture: they do not all lie beyond one of its edges."""
    if _inside(eye, eye.X_WC.local(thing.middle)):
        return True
    (x0, y0, z0), (x1, y1, z1) = thing.low, thing.high
    corners = [eye.X_WC.local((x, y, z)) for x in (x0, x1) for y in (y0, y1) for z in (z0, z1)]
    beyond = zip(*(_sides(eye, p) for p in corners), strict=True)
    return not any(all(v < 0 for v in side) for side in beyond)


def _inside(eye: Eye, p: Vec) -> bool:
    return all(v >= 0 for v in _sides(eye, p))


def _sides(eye: Eye, p: Vec) -> tuple[float, float, float, float, float]:
    """How far a point in the camera's frame is before the camera and inside each edge of its picture, by sign."""
    spec = eye.spec
    width, height = spec.size
    cx = (width - 1) / 2 if spec.cx is None else spec.cx
    cy = (height - 1) / 2 if spec.cy is None else spec.cy
    x, y, z = spec.fx * p[0], spec.fy * p[1], p[2]
    return (z, x + (cx + 0.5) * z, (width - 0.5 - cx) * z - x, y + (cy + 0.5) * z, (height - 0.5 - cy) * z - y)


def off_axis(eye: Eye, p: Vec) -> float:
    """The angle between the optical axis and a point in the world [deg]."""
    x, y, z = eye.X_WC.local(p)
    return math.degrees(math.atan2(math.hypot(x, y), z))


def half_angle(eye: Eye) -> float:
    """The angle between the optical axis and the farthest corner of the picture [deg]."""
    spec = eye.spec
    width, height = spec.size
    cx = (width - 1) / 2 if spec.cx is None else spec.cx
    cy = (height - 1) / 2 if spec.cy is None else spec.cy
    across = max(cx + 0.5, width - 0.5 - cx) / spec.fx
    down = max(cy + 0.5, height - 0.5 - cy) / spec.fy
    return math.degrees(math.atan(math.hypot(across, down)))
