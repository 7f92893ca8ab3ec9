"""A page that shows a change: the scene before and after as pictures, and what changed as a list.

One file without scripts and without links, to be attached to a pull request. All text from documents is escaped, and
the same documents give the same bytes.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from html import escape
from typing import TYPE_CHECKING

from simfoundry.review.labels import Label, place_labels
from simfoundry.review.style import STYLE
from simfoundry.runtime.outputs import MARK
from simfoundry.spec.change.compare import DocumentComparison, Side
from simfoundry.spec.change.diff.poses import motion, words
from simfoundry.spec.change.diff.words import MemberChange, summary
from simfoundry.spec.diagnostics import SpecError
from simfoundry.spec.models.scene import SceneSpec

if TYPE_CHECKING:
    from simfoundry.review.pictures import Picture, Tint
    from simfoundry.scene.model import Camera, Scene

COLORS = {
    "moved": (0xF0, 0x8C, 0x00),
    "added": (0x2F, 0x9E, 0x44),
    "removed": (0xE0, 0x31, 0x31),
    "changed": (0x1C, 0x7E, 0xD6),
}
"""What a mark looks like in pictures and in the list (sRGB bytes)."""

SEEN_M, SEEN_DEG = 5e-4, 0.1
"""A move along with something else counts from half a millimetre and a tenth of a degree on: less is how a thing lies
on a surface that is reckoned anew."""

_MEANING = {"moved": "moved or turned", "changed": "changed or renamed", "added": "added", "removed": "removed"}


def page(comparisons: Sequence[DocumentComparison]) -> str:
    """The page of some documents."""
    title = comparisons[0].name if len(comparisons) == 1 else f"{len(comparisons)} documents"
    colors = "".join(f".{mark}{{--mark:#{r:02x}{g:02x}{b:02x}}}" for mark, (r, g, b) in COLORS.items())
    lowered = [_lowered_sides(c) for c in comparisons]
    comparisons = [_with_moves(c, scenes) for c, scenes in zip(comparisons, lowered, strict=True)]
    body = "\n".join("\n".join(_document(c, lowered[k], f"d{k}")) for k, c in enumerate(comparisons))
    empty = "<article><p>No document differs.</p></article>"
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="generator" content="{MARK}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; img-src data:; style-src 'unsafe-inline'">
<title>{escape(title)}</title>
<style>
{STYLE}{colors}
{"".join(_hover(c, f"d{k}") for k, c in enumerate(comparisons))}</style>
</head>
<body>
{body or empty}
</body>
</html>
"""


def mark_of(entry: MemberChange) -> str:
    """The mark that decides the colour of a thing."""
    return next((mark for mark in ("added", "removed", "moved") if mark in entry.marks), "changed")


def _hover(comparison: DocumentComparison, key: str) -> str:
    """Rules by which an entry and its tags in the pictures light up together."""
    named = [k for k, entry in enumerate(comparison.entries) if entry.name]
    return "".join(f"body:has(.{key}-{k}:hover) .{key}-{k}{{outline:2px solid var(--mark)}}\n" for k in named)


def _document(comparison: DocumentComparison, lowered: Sequence[Scene | str], key: str) -> Iterator[str]:
    yield "<article>"
    yield f"<h1>{escape(comparison.name)}</h1>"
    yield f'<p class="sides"><code>{_label(comparison.old)}</code> → <code>{_label(comparison.new)}</code></p>'
    if comparison.entries:
        yield f'<p class="summary">{escape(summary(comparison.entries))}</p>'
    yield from _pictures(comparison, lowered, key)
    if comparison.entries:
        yield '<ul class="changes">'
        yield from (_entry(entry, f"{key}-{k}") for k, entry in enumerate(comparison.entries))
        yield "</ul>"
    else:
        yield from (f"<p>{escape(line)}</p>" for line in comparison.lines())
    yield from _findings(comparison)
    yield "</article>"


def _with_moves(comparison: DocumentComparison, lowered: Sequence[Scene | str]) -> DocumentComparison:
    """The comparison with the moves that no text says: of what stands on or beside something that changed."""
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
        told = words(found)
        if entry is None:
            entries.append(MemberChange("objects", item.name, "", ("moved",), (*told, "with what its place names"), ()))
        else:
            marks = ("moved", *entry.marks)
            entries[known[item.name]] = replace(entry, marks=marks, verbs=(*entry.verbs, *told))
    return replace(comparison, entries=tuple(entries))


def _label(side: Side | None) -> str:
    return escape(side.label) if side is not None else "nothing"


def _entry(entry: MemberChange, key: str) -> str:
    verbs = f" {escape(', '.join(entry.verbs))}" if entry.verbs else ""
    facts = [escape(fact) for fact in entry.facts]
    if not entry.name:
        return f'<li class="{mark_of(entry)}">{"; ".join(facts)}</li>'
    tail = f"<ul>{''.join(f'<li>{fact}</li>' for fact in facts)}</ul>" if facts else ""
    return f'<li class="{mark_of(entry)} {key}"><b>{escape(entry.subject)}</b>{verbs}{tail}</li>'


def _findings(comparison: DocumentComparison) -> Iterator[str]:
    if comparison.findings:
        yield "<h2>Errors</h2>"
        yield '<ul class="findings">'
        for d in comparison.findings:
            place = f"{d.file}:{d.line}:{d.column}" if d.line else d.file
            yield f"<li><code>{escape(place)}</code> {escape(d.code)} {escape(d.message)}</li>"
        yield "</ul>"


# -- pictures -------------------------------------------------------------------------------------------------------


def _lowered_sides(comparison: DocumentComparison) -> tuple[Scene | str, ...]:
    """Both scenes, or why one cannot be shown; nothing for documents of other kinds."""
    sides = (comparison.old, comparison.new)
    if not any(side is not None and isinstance(side.spec, SceneSpec) for side in sides):
        return ()
    return tuple(_lowered(side) for side in sides)


def _pictures(comparison: DocumentComparison, lowered: Sequence[Scene | str], key: str) -> Iterator[str]:
    """Both scenes side by side, or the reason why one is not shown; nothing for documents of other kinds."""
    if not lowered:
        return
    sides = (comparison.old, comparison.new)
    scenes = [scene for scene in lowered if not isinstance(scene, str)]
    yield '<div class="pair">'
    if scenes:
        from simfoundry.review.pictures import common_camera, picture

        views = [_viewpoint(side, scene) for side, scene in zip(sides, lowered, strict=True)]
        camera = common_camera(scenes, reversed(views))  # as the new document sees it
        tints = _tints(comparison, lowered)
        for side, scene, tint, new in zip(sides, lowered, tints, (False, True), strict=True):
            shown = scene if isinstance(scene, str) else picture(scene, camera, _colors(comparison, new), tint)
            yield _figure(side, shown, _keys(comparison, key, new), "after" if new else "before")
    else:
        for side, scene, name in zip(sides, lowered, ("before", "after"), strict=True):
            yield _figure(side, str(scene), {}, name)
    yield "</div>"
    if scenes and comparison.entries:
        swatches = (f'<span class="{mark}">{meaning}</span>' for mark, meaning in _MEANING.items())
        yield f'<p class="legend">{"".join(swatches)}</p>'


def _tints(comparison: DocumentComparison, lowered: Sequence[Scene | str]) -> tuple[dict[str, Tint], dict[str, Tint]]:
    """The tints of both scenes; an object has one tint, also under a new name."""
    from simfoundry.review.pictures import tints_of

    was = {entry.name: entry.was for entry in comparison.entries if entry.section == "objects" and entry.was}
    now = {old: new for new, old in was.items()}
    names = [[] if isinstance(scene, str) else [item.name for item in scene.objects] for scene in lowered]
    tints = tints_of([*(now.get(name, name) for name in names[0]), *names[1]])
    return {name: tints[now.get(name, name)] for name in names[0]}, tints


def _lowered(side: Side | None) -> Scene | str:
    """The scene of a side, or why there is none."""
    from simfoundry.assets.cache import Cache
    from simfoundry.errors import SimfoundryError
    from simfoundry.scene.lower import lower

    if side is None:
        return "There is no such document."
    if not isinstance(side.spec, SceneSpec):
        return "This is not a scene."
    try:
        return lower(side.loaded, Cache.default(), fetch=False)
    except SpecError as error:
        first = error.diagnostics[0]
        count = len(error.diagnostics)
        return f"It cannot be shown: {first.message}" + (f" (and {count - 1} more)" if count > 1 else "") + "."
    except (SimfoundryError, OSError, ValueError) as error:
        return f"It cannot be shown: {error}"


def _viewpoint(side: Side | None, scene: Scene | str) -> Camera | None:
    """The camera from which a scene is seen, if its viewpoint is a camera."""
    if side is None or isinstance(scene, str) or not isinstance(side.spec, SceneSpec):
        return None
    return next((c for c in scene.cameras if c.name == side.spec.viewpoint), None)


def _keys(comparison: DocumentComparison, key: str, new: bool) -> dict[str, tuple[str, MemberChange]]:
    """The changed objects of the old or the new scene by the name that they have there, each with its CSS class."""
    out: dict[str, tuple[str, MemberChange]] = {}
    for k, entry in enumerate(comparison.entries):
        if entry.section == "objects":
            out.setdefault(entry.name if new else entry.was or entry.name, (f"{key}-{k}", entry))
    return out


def _colors(comparison: DocumentComparison, new: bool) -> dict[str, tuple[int, int, int]]:
    return {name: COLORS[mark_of(entry)] for name, (_, entry) in _keys(comparison, "", new).items()}


def _figure(side: Side | None, shown: Picture | str, keys: dict[str, tuple[str, MemberChange]], caption: str) -> str:
    label = f"{caption}: <code>{_label(side)}</code>"
    if isinstance(shown, str):
        return f'<figure><div class="none">{escape(shown)}</div><figcaption>{label}</figcaption></figure>'
    data = base64.b64encode(shown.png).decode()
    tags = "".join(_tag(label, *keys[label.name]) for label in place_labels(shown.tags, shown.width / shown.height))
    image = f'<img src="data:image/png;base64,{data}" width="{shown.width}" height="{shown.height}" alt="{caption}">'
    return f'<figure><div class="view">{image}{tags}</div><figcaption>{label}</figcaption></figure>'


def _tag(label: Label, key: str, entry: MemberChange) -> str:
    """A label, and the line from it to what it names."""
    mark = mark_of(entry)
    top, height = min(label.y, label.thing_y), abs(label.thing_y - label.y)
    stem = f"left:{100 * label.thing_x:.2f}%;top:{100 * top:.2f}%;height:{100 * height:.2f}%"
    place = f"left:{100 * label.x:.2f}%;top:{100 * label.y:.2f}%"
    return (
        f'<span class="stem {mark}" style="{stem}"></span>'
        f'<span class="tag {mark} {key}" style="{place}" title="{escape(label.name)}">{escape(label.text)}</span>'
    )
