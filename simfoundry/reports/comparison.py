"""A page that shows the changes to a document: images of the scene before and after, and a list of changes.

The page is a single file without scripts or links, so it can be attached to a pull request. All text from documents is
escaped, and identical documents produce identical output.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from simfoundry.reports.pictures import Tint, common_camera, picture, place_labels, tints_of
from simfoundry.reports.render import render
from simfoundry.spec.change.compare import DocumentComparison, Side
from simfoundry.spec.change.diff.values import motion, motion_words
from simfoundry.spec.change.diff.words import MemberChange, summary
from simfoundry.spec.diagnostics import SpecError
from simfoundry.spec.models.scene import SceneSpec

if TYPE_CHECKING:
    from simfoundry.scene.model import Camera, Scene

# Colors of the marks in images and in the list of changes (sRGB bytes).
COLORS = {
    "moved": (0xF0, 0x8C, 0x00),
    "added": (0x2F, 0x9E, 0x44),
    "removed": (0xE0, 0x31, 0x31),
    "changed": (0x1C, 0x7E, 0xD6),
}

# Minimum indirect motion that is reported: half a millimeter or a tenth of a degree. Smaller motions are caused by
# solving a placement again.
SEEN_M, SEEN_DEG = 5e-4, 0.1


def page(comparisons: Sequence[DocumentComparison]) -> str:
    """Render the page for the given documents."""
    documents = [described_document(c, f"d{k}") for k, c in enumerate(comparisons)]
    title = comparisons[0].name if len(comparisons) == 1 else f"{len(comparisons)} documents"
    context = {"sources": "", "colors": COLORS, "mark_of": mark_of}
    return render("comparison.html.j2", title=title, documents=documents, **context)


def mark_of(entry: MemberChange) -> str:
    """Return the mark that determines the color of a change."""
    return next((mark for mark in ("added", "removed", "moved") if mark in entry.marks), "changed")


def described_document(comparison: DocumentComparison, key: str) -> dict[str, Any]:
    """Return the template variables for one document, with images of the scenes.

    ``key`` is a prefix for the names of CSS classes.
    """
    lowered = _lowered_sides(comparison)
    comparison = _with_moves(comparison, lowered)
    return {
        "key": key,
        "name": comparison.name,
        "old": _label(comparison.old),
        "new": _label(comparison.new),
        "summary": summary(comparison.entries),
        "sides": _pictures(comparison, lowered, key) if lowered else [],
        "entries": comparison.entries,
        "lines": comparison.lines() if not comparison.entries else [],
        "findings": comparison.findings,
    }


def _with_moves(comparison: DocumentComparison, lowered: Sequence[Scene | str]) -> DocumentComparison:
    """Add the objects that moved because their `place` refers to an object that changed."""
    old, new = lowered if lowered else ("", "")
    if isinstance(old, str) or isinstance(new, str):
        return comparison
    entries = list(comparison.entries)
    known = {entry.name: k for k, entry in enumerate(entries) if entry.section == "objects"}
    before = {item.name: item for item in old.objects}
    for item in new.objects:
        entry = entries[known[item.name]] if item.name in known else None
        there = before.get((entry.was if entry is not None else "") or item.name)
        if there is None or (entry is not None and "moved" in entry.marks):
            continue
        found = motion(*({"xyz": tuple(X.p), "quat_wxyz": tuple(X.q)} for X in (there.X_WO, item.X_WO)))
        if math.hypot(*found.shift) < SEEN_M and found.angle < SEEN_DEG:
            continue
        words = motion_words(found)
        if entry is None:
            verbs = (*words, "along with the object that its place refers to")
            entries.append(MemberChange("objects", item.name, "", ("moved",), verbs, ()))
        else:
            marks = ("moved", *entry.marks)
            entries[known[item.name]] = replace(entry, marks=marks, verbs=(*entry.verbs, *words))
    return replace(comparison, entries=tuple(entries))


def _label(side: Side | None) -> str:
    return side.label if side is not None else "nothing"


# -- images ---------------------------------------------------------------------------------------------------------


def _lowered_sides(comparison: DocumentComparison) -> tuple[Scene | str, ...]:
    """Return both scenes, or the reasons why they cannot be shown.

    The result is empty for other document kinds.
    """
    sides = (comparison.old, comparison.new)
    if not any(side is not None and isinstance(side.spec, SceneSpec) for side in sides):
        return ()
    return tuple(_lowered(side) for side in sides)


def _pictures(comparison: DocumentComparison, lowered: Sequence[Scene | str], key: str) -> list[dict[str, Any]]:
    """Return the template variables for both scenes, each with an image or the reason why there is none."""
    sides = (comparison.old, comparison.new)
    views = [_viewpoint(side, scene) for side, scene in zip(sides, lowered, strict=True)]
    # The viewpoint of the new document takes precedence.
    camera = common_camera([scene for scene in lowered if not isinstance(scene, str)], reversed(views))
    found = []
    for new, side, scene, tints in zip((False, True), sides, lowered, _tints(comparison, lowered), strict=True):
        about: dict[str, Any] = {"caption": "after" if new else "before", "label": _label(side), "picture": None}
        if isinstance(scene, str):
            found.append({**about, "reason": scene})
            continue
        keys = _keys(comparison, key, new)
        shown = picture(scene, camera, {name: COLORS[mark_of(entry)] for name, (_, entry) in keys.items()}, tints)
        labels = place_labels(shown.tags, shown.width / shown.height)
        found.append({**about, "picture": shown, "labels": labels, "changes": keys})
    return found


def _tints(comparison: DocumentComparison, lowered: Sequence[Scene | str]) -> tuple[dict[str, Tint], dict[str, Tint]]:
    """Return the tints of objects in both scenes. A renamed object keeps its tint."""
    was = {entry.name: entry.was for entry in comparison.entries if entry.section == "objects" and entry.was}
    now = {old: new for new, old in was.items()}
    names = [[] if isinstance(scene, str) else [item.name for item in scene.objects] for scene in lowered]
    tints = tints_of([*(now.get(name, name) for name in names[0]), *names[1]])
    return {name: tints[now.get(name, name)] for name in names[0]}, tints


def _lowered(side: Side | None) -> Scene | str:
    """Return the scene on one side, or the reason why it cannot be shown."""
    from simfoundry.assets.cache import Cache
    from simfoundry.errors import SimfoundryError
    from simfoundry.scene.lower import lower

    if side is None:
        return "The document does not exist."
    if not isinstance(side.spec, SceneSpec):
        return "The document is not a scene."
    try:
        return lower(side.loaded, Cache.default(), fetch=False)
    except SpecError as error:
        first = error.diagnostics[0]
        count = len(error.diagnostics)
        return f"The scene cannot be shown: {first.message}" + (f" (and {count - 1} more)" if count > 1 else "") + "."
    except (SimfoundryError, OSError, ValueError) as error:
        return f"The scene cannot be shown: {error}"


def _viewpoint(side: Side | None, scene: Scene | str) -> Camera | None:
    """Return the scene's viewpoint if it is a camera."""
    if side is None or isinstance(scene, str) or not isinstance(side.spec, SceneSpec):
        return None
    return next((c for c in scene.cameras if c.name == side.spec.viewpoint), None)


def _keys(comparison: DocumentComparison, key: str, new: bool) -> dict[str, tuple[str, MemberChange]]:
    """Return the CSS class and the change for each changed object, keyed by its name in the old or the new scene."""
    out: dict[str, tuple[str, MemberChange]] = {}
    for k, entry in enumerate(comparison.entries):
        if entry.section == "objects":
            out.setdefault(entry.name if new else entry.was or entry.name, (f"{key}-{k}", entry))
    return out
