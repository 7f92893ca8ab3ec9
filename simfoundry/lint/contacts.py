"""Lints SF410 and SF411: interpenetrating objects, and free objects without support."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import product

import numpy as np

from simfoundry.geometry.frames import Array
from simfoundry.geometry.vertical_contact import heights
from simfoundry.lint.draft import DraftScene
from simfoundry.lint.lints import Lint, Subject, warning, where
from simfoundry.scene.lengths import length, number
from simfoundry.scene.model import SceneObject
from simfoundry.spec.diagnostics import Diagnostic

# Penetration depth [m] that simulators resolve on their own, and that is common for captured objects.
DEEP = 0.002

# Maximum lift needed to separate two objects, as a multiple of their penetration depth, at which the upper object is
# considered to have sunk into the lower object from above.
STEEPEST = 1.5

# Maximum number of neighboring pairs measured in one scene; measuring this many takes seconds. A table with 1,000
# objects has a few hundred neighboring pairs. Any remaining pairs are measured once the first findings are fixed.
MOST_PAIRS = 6_000


def overlaps(subject: Subject) -> Iterator[Diagnostic]:
    """Find pairs of interpenetrating objects, except pairs that are both fixed or whose contacts are excluded."""
    draft = subject.scene
    silent = {frozenset(pair) for pair in draft.spec.no_contact}
    for a, b in neighbors(draft)[:MOST_PAIRS]:
        if (a.fixed and b.fixed) or frozenset((a.name, b.name)) in silent or _is_placed_on(draft, a, b):
            continue
        subject.checkpoint()
        if draft.distance(a.name, b.name, -DEEP) < -DEEP:
            yield _overlap_finding(subject, a, b)


def neighbors(draft: DraftScene) -> list[tuple[SceneObject, SceneObject]]:
    """Return pairs of objects with known convex parts whose bounding boxes overlap by more than :data:`DEEP`."""
    items = [item for item in draft.solids if item.name not in draft.approximate]
    if not items:
        return []
    low, high = (np.array([draft.bounds[item.name][k] for item in items]) for k in (0, 1))
    found = []
    for k in range(len(items) - 1):
        near = ((low[k + 1 :] + DEEP < high[k]) & (low[k] + DEEP < high[k + 1 :])).all(axis=1)
        found += [(items[k], items[k + 1 + j]) for j in np.flatnonzero(near).tolist()]
    return found


def _is_placed_on(draft: DraftScene, a: SceneObject, b: SceneObject) -> bool:
    """Return True if one object is placed on or in the other, so that lowering has computed their relative pose."""
    places = (draft.spec.objects[one.name].place for one in (a, b))
    carriers = [(place.on or place.inside or "").partition(".")[0] for place in places if place is not None]
    return a.name in carriers or b.name in carriers


def _overlap_finding(subject: Subject, a: SceneObject, b: SceneObject) -> Diagnostic:
    """Return a finding about the object that can be moved, or about the second object if both can be moved."""
    draft, loaded = subject.scene, subject.loaded
    moved, other = (a, b) if b.fixed else (b, a)
    depth = draft.overlap(a.name, b.name)
    message = f"`{moved.name}` and `{other.name}` overlap by {length(depth)}"
    raised = float(heights(draft.shapes[moved.name], draft.shapes[other.name]).max())
    hint = "move one of them away from the other"
    if 0 < raised <= STEEPEST * depth:
        hint = f"raise `{moved.name}` by {length(raised)}, to z = {number(float(moved.X_WO.p[2]) + raised)}"
    if len(where(loaded, moved.name)) == 2:
        hint = f"it has neither `place` nor `pose`, so it is at the origin; write `place: {{on: {other.name}}}`"
    hint += f"; if the overlap is intended, write `allow: {{SF410: {{{moved.name}: why}}}}`"
    return warning(loaded, "SF410", where(loaded, moved.name), message, hint, (other.name,))


OVERLAP = Lint("SF410", ("scene/1",), overlaps)


# Maximum gap between an object and its support [m]; an object that falls by this much hardly bounces.
HOVERING = 0.005

# Tolerance for contact [m]: the distance by which the prisms that represent cylinders protrude.
CLOSE = 5e-5

# Maximum number of pairs (an object and a possible support) measured in one scene; each pair takes about a millisecond.
# In a wall of a thousand bricks, each brick has eight neighbors.
MOST_MEASURED = 20_000


def unsupported(subject: Subject) -> Iterator[Diagnostic]:
    """Find free objects that would fall. Only scenes with a fixed object and downward gravity are checked."""
    draft = subject.scene
    gx, gy, gz = draft.spec.gravity
    if gx or gy or gz >= 0 or not any(item.fixed for item in draft.solids):
        return
    items = draft.solids
    low, high = (np.array([draft.bounds[item.name][k] for item in items]) for k in (0, 1))
    measured = 0
    for k, item in enumerate(items):
        if item.fixed or draft.spec.objects[item.name].place is not None:
            continue
        subject.checkpoint()
        near = ((low <= high[k] + HOVERING) & (low[k] - HOVERING <= high)).all(axis=1)
        near[k] = False
        below = sorted(np.flatnonzero(near).tolist(), key=lambda j: (abs(high[j, 2] - low[k, 2]), j))
        measured += len(below)
        if measured > MOST_MEASURED:
            return
        if not any(supports(draft, items[j], item) for j in below) and not _may_rest_on_unplaced(draft):
            yield _falling(subject, item)


def supports(draft: DraftScene, support: SceneObject, item: SceneObject) -> bool:
    """Return True if an object touches its support immediately or after falling by at most :data:`HOVERING`.

    If only the convex hull of either object is known, the support is assumed to be sufficient.
    """
    if draft.approximate & {support.name, item.name}:
        return True
    upper, lower = draft.shapes[item.name], draft.shapes[support.name]
    touching = heights(upper, lower)
    if ((touching >= -HOVERING - CLOSE) & (touching <= CLOSE)).any():
        return True
    if not (touching > CLOSE).any():
        return False
    # Interpenetrating objects are reported by SF410, not as falling. An object that only covers another, such as a
    # lid, does not support it.
    leaving = -heights(upper.flipped(), lower.flipped())
    rising = touching[touching > CLOSE] < -leaving[touching > CLOSE]
    return bool(rising.any()) or draft.distance(item.name, support.name, -DEEP) < -DEEP


def _may_rest_on_unplaced(draft: DraftScene) -> bool:
    """Return True if the poses of some objects are uncertain, because other objects might then rest on them."""
    return any(name in draft.unplaced for name in draft.scene.by_name)


def _falling(subject: Subject, item: SceneObject) -> Diagnostic:
    """Return a finding that states how far the object falls and what it lands on."""
    draft = subject.scene
    low, high = draft.bounds[item.name]
    below: list[tuple[float, str]] = []
    for other in sorted(draft.solids, key=lambda o: -float(draft.bounds[o.name][1][2])):
        bottom, top = draft.bounds[other.name]
        if below and top[2] - low[2] < max(below)[0]:
            break  # no object with a lower top can stop it earlier
        if other is not item and bottom[2] < low[2] and (bottom <= high)[:2].all() and (low <= top)[:2].all():
            raised = float(heights(draft.shapes[item.name], draft.shapes[other.name]).max())
            if np.isfinite(raised) and raised < 0:
                below.append((raised, other.name))
    path = where(subject.loaded, item.name)
    if not below:
        message = f"nothing supports `{item.name}`, and there is nothing below it"
        hint = "put it on an object with `place`, or weld it to the world with `fixed: true`"
        return warning(subject.loaded, "SF411", path, message, hint)
    raised, name = max(below)
    message = f"nothing supports `{item.name}`: it falls {length(-raised)} onto `{name}`"
    z = number(float(item.X_WO.p[2]) + raised)
    hint = f"lower it to z = {z}, where it would rest, or write `place: {{on: {name}, ...}}`"
    return warning(subject.loaded, "SF411", path, message, hint, (name,))


UNSUPPORTED = Lint("SF411", ("scene/1",), unsupported)


def region_off_support(subject: Subject) -> Iterator[Diagnostic]:
    """Find reset regions with a cell in which nothing is below the object, so that no initial state is found for it.

    Only bounding boxes are compared, so a cell that is partly on a support is not reported.
    """
    draft, grid = subject.scene, subject.task.reset.grid
    if _may_rest_on_unplaced(draft) or not any(item.fixed for item in draft.scene.objects):
        return
    for name, region in subject.task.reset.objects.items():
        if name not in draft.bounds:
            continue
        low, high = draft.bounds[name]
        x, y = draft.scene.by_name[name].X_WO.p[:2].tolist()
        around = max(math.dist(corner, (x, y)) for corner in product((low[0], high[0]), (low[1], high[1])))
        below = [b for other, b in draft.bounds.items() if other != name and b[0][2] < low[2] + CLOSE]
        for cell in product(*(_ends(ends, count) for ends, count in zip((region.x, region.y), grid, strict=True))):
            if not any(_overlaps(cell, bottom, top, around) for bottom, top in below):
                spans = " and ".join(f"{axis} {a:.3g} to {b:.3g}" for axis, (a, b) in zip("xy", cell, strict=True))
                message = f"nothing is below `{name}` in the cell of its region at {spans}"
                hint = "an initial state must exist for each cell; make the region smaller, or move it over the support"
                yield warning(subject.loaded, "SF411", ("reset", "objects", name), message, hint, (name,))
                break


def _ends(ends: tuple[float, float], count: int) -> list[tuple[float, float]]:
    """Return the first and the last of ``count`` equal intervals between two ends."""
    step = (ends[1] - ends[0]) / count
    return [(ends[0], ends[0] + step), (ends[1] - step, ends[1])]


def _overlaps(cell: tuple[tuple[float, float], ...], low: Array, high: Array, around: float) -> bool:
    """Return True if a box is within ``around`` [m] of a cell, given by its intervals along x and y."""
    return all(a - around < high[k] and low[k] < b + around for k, (a, b) in enumerate(cell))


REGION_OFF_SUPPORT = Lint("SF411", ("task/1",), region_off_support)
