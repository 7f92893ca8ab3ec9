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
"""Things that interpenetrate by no more than this [m] come apart by themselves; captured ones do as much."""

STEEPEST = 1.5
"""What comes free when it is raised by no more than this many times the depth has sunk in from above."""

MOST_MEASURED = 6_000
"""Pairs of objects near each other that are measured for one scene, which takes seconds; 1,000 things on a table have
some hundreds. What lies beyond is looked at once the first findings are mended."""


def overlaps(subject: Subject) -> Iterator[Diagnostic]:
    """Find pairs that interpenetrate, unless both are fixed, or shall pass through each other."""
    draft = subject.scene
    silent = {frozenset(pair) for pair in draft.spec.no_contact}
    found = 0
    for a, b in neighbours(draft)[:MOST_MEASURED]:
        if (a.fixed and b.fixed) or frozenset((a.name, b.name)) in silent or _is_placed_on(draft, a, b):
            continue
        if draft.distance(a.name, b.name, -DEEP) < -DEEP:
            yield _overlap(subject, a, b)
            found += 1
            if found >= MOST:
                return


def neighbours(draft: DraftScene) -> list[tuple[SceneObject, SceneObject]]:
    """Pairs of objects known by their parts whose boxes overlap by more than :data:`DEEP`."""
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
    """Return True if the place of one names the other: then lowering has put the two together."""
    places = (draft.spec.objects[one.name].place for one in (a, b))
    carriers = [(place.on or place.inside or "").partition(".")[0] for place in places if place is not None]
    return a.name in carriers or b.name in carriers


def _overlap(subject: Subject, a: SceneObject, b: SceneObject) -> Diagnostic:
    """The finding at what can be moved, of two the later."""
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
    hint += f"; what shall be like this is `allow: {{SF410: {{{moved.name}: why}}}}`"
    return warning(loaded, "SF410", where(loaded, moved.name), message, hint, (other.name,))


LINT = Lint("SF410", ("scene/1",), overlaps)
