"""SF410: objects that interpenetrate."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from simfoundry.geometry.vertical_contact import heights
from simfoundry.lint.draft import DraftScene
from simfoundry.lint.lints import Lint, Subject
from simfoundry.lint.report import MOST, warning, where
from simfoundry.scene.lengths import length, number
from simfoundry.scene.model import SceneObject
from simfoundry.spec.diagnostics import Diagnostic

DEEP = 0.002
"""Penetration [m] that simulators resolve by themselves; captured objects have as much."""

STEEPEST = 1.5
"""Lift that separates two objects, as a multiple of the depth, up to which the upper one counts as sunk in from
above."""

MOST_MEASURED = 6_000
"""Number of pairs of neighbors measured for one scene, which takes seconds; 1,000 objects on a table have some
hundreds. Further pairs are measured once the first findings are fixed."""


def overlaps(subject: Subject) -> Iterator[Diagnostic]:
    """Find interpenetrating pairs, unless both are fixed or their contacts are excluded."""
    draft = subject.scene
    silent = {frozenset(pair) for pair in draft.spec.no_contact}
    found = 0
    for a, b in neighbors(draft)[:MOST_MEASURED]:
        if (a.fixed and b.fixed) or frozenset((a.name, b.name)) in silent or _is_placed_on(draft, a, b):
            continue
        if draft.distance(a.name, b.name, -DEEP) < -DEEP:
            yield _overlap(subject, a, b)
            found += 1
            if found >= MOST:
                return


def neighbors(draft: DraftScene) -> list[tuple[SceneObject, SceneObject]]:
    """Pairs of objects with known parts whose boxes overlap by more than :data:`DEEP`."""
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
    """Return True if the placement of one names the other: lowering then defined their relative pose."""
    places = (draft.spec.objects[one.name].place for one in (a, b))
    carriers = [(place.on or place.inside or "").partition(".")[0] for place in places if place is not None]
    return a.name in carriers or b.name in carriers


def _overlap(subject: Subject, a: SceneObject, b: SceneObject) -> Diagnostic:
    """Return the finding for the object that can be moved; of two, for the later one."""
    draft, loaded = subject.scene, subject.loaded
    moved, other = (a, b) if b.fixed else (b, a)
    depth = draft.overlap(a.name, b.name)
    message = f"`{moved.name}` and `{other.name}` overlap by {length(depth)}"
    raised = float(heights(draft.shapes[moved.name], draft.shapes[other.name]).max())
    hint = "move one of them away from the other"
    if 0 < raised <= STEEPEST * depth:
        hint = f"raise `{moved.name}` by {length(raised)}, to z = {number(float(moved.X_WO.p[2]) + raised)}"
    if len(where(loaded, moved.name)) == 2:
        hint = f"it has no `place` and no `pose`, so it is at the origin: write `place: {{on: {other.name}}}`"
    hint += f"; if the overlap is intended, write `allow: {{SF410: {{{moved.name}: why}}}}`"
    return warning(loaded, "SF410", where(loaded, moved.name), message, hint, (other.name,))


LINT = Lint("SF410", ("scene/1",), overlaps)
