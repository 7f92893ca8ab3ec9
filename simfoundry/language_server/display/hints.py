"""Computed values within the text: resolved positions and masses, numbers of copies, and values of expressions."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from lsprotocol import types

from simfoundry.language_server.analysis import Analysis
from simfoundry.language_server.display.hover import HoverContext
from simfoundry.spec.compose.parameters import ParameterError, evaluate, is_expression
from simfoundry.spec.files import Loaded
from simfoundry.spec.models.asset import AssetSpec
from simfoundry.spec.yaml.spans import TextSpan
from simfoundry.spec.yaml.write import number

# Maximum number of hints in an answer; an editor asks for a few screens at a time.
MOST_HINTS = 1000

# Longest expression [characters]; a longer text that contains `$` is not evaluated.
MOST_EXPRESSION = 200

# Decimals of a position [m] in a hint: a tenth of a millimeter.
_DECIMALS = 4


@dataclass(frozen=True)
class ValueHint:
    """A text that is shown after the character at an offset, with an explanation."""

    offset: int
    label: str
    tooltip: str


def inlay_hints(context: HoverContext, within: types.Range) -> list[types.InlayHint]:
    """Return the hints in a range of the text."""
    lines = context.analysis.lines
    start, end = lines.span(within)
    found: list[types.InlayHint] = []
    for hint in sorted(_hints(context, start, end), key=lambda hint: hint.offset):
        if start <= hint.offset <= end and len(found) < MOST_HINTS:
            place = lines.position(hint.offset)
            found.append(types.InlayHint(place, hint.label, tooltip=hint.tooltip, padding_left=True))
    return found


def _hints(context: HoverContext, start: int, end: int) -> Iterator[ValueHint]:
    root = context.analysis.spans
    yield from _expressions(context.analysis, root, start, end)
    scene = context.scene
    if context.draft is not None and scene is not None:
        if scene is context.lowered:
            for name, span in _shown(root.at(("objects",)), start, end):
                yield from _object_hints(context, scene, name, span)
        for key in ("place", "pose"):
            for name, span in _shown(root.at(("start", key)), start, end):
                yield from _position_hint(context, scene, name, key, span)
    if isinstance(context.analysis.loaded.spec, AssetSpec):
        yield from _link_hints(context.analysis, context.analysis.loaded.spec, root.at(("links",)), start, end)


def _shown(section: TextSpan | None, start: int, end: int) -> Iterator[tuple[str, TextSpan]]:
    """Yield the members of a section that are in a range of the text."""
    for name, span in section.entries() if section is not None else ():
        if span.end >= start and span.outer <= end:
            yield str(name), span


def _object_hints(context: HoverContext, scene: Loaded, name: str, span: TextSpan) -> Iterator[ValueHint]:
    from simfoundry.scene.mass_facts import mass_source

    draft = context.draft
    assert draft is not None
    group = scene.reuse.groups.get(name) if scene.reuse is not None else None
    if group is not None and (repeat := span.at(("repeat",))) is not None:
        count = len(group.copies)
        names = ", ".join(copy.name for copy in group.copies[:3]) + (", …" if count > 3 else "")
        yield ValueHint(_after(repeat), f"{count} cop{'y' if count == 1 else 'ies'}", names)
    first = group.copies[0].name if group is not None and group.copies else name
    item, written = draft.scene.by_name.get(first), draft.spec.objects.get(first)
    if item is None or written is None:
        return
    if not item.fixed and written.mass is None:
        at = next((found for key in ("density", "material", "asset") if (found := span.at((key,))) is not None), None)
        kg = sum(link.mass for link in item.links)
        each = " each" if group is not None else ""
        yield ValueHint(_after(at if at is not None else span), f"{kg:.3g} kg{each}",
                        f"Mass: {mass_source(scene, item).replace('`', '')}")  # fmt: skip
    for key in ("place", "pose"):
        if (found := span.at((key,))) is not None:
            yield from _position_hint(context, scene, name, key, found)


def _position_hint(context: HoverContext, scene: Loaded, name: str, key: str, span: TextSpan) -> Iterator[ValueHint]:
    """Yield the resolved position of an object with a place, or with a pose in a frame."""
    draft = context.draft
    assert draft is not None
    group = scene.reuse.groups.get(name) if scene.reuse is not None else None
    copies = [copy.name for copy in group.copies] if group is not None else [name]
    items = [draft.scene.by_name[one] for one in copies if one in draft.scene.by_name and one not in draft.unplaced]
    if not items or (key == "pose" and span.at(("frame",)) is None):
        return
    x, y, z = (float(v) for v in items[0].X_WO.p)
    is_level = all(abs(float(item.X_WO.p[2]) - z) < 10**-_DECIMALS for item in items)
    shown = _number(z) if is_level else f"{_number(z)} …"
    has_xy = span.at(("xy",)) is not None and span.at(("frame",)) is None and span.at(("offset",)) is None
    label = (
        f"z {shown}" if key == "place" and (has_xy or len(items) > 1) else f"xyz [{_number(x)}, {_number(y)}, {shown}]"
    )
    yield ValueHint(_after(span), label, f"Position of {copies[0]} in the world [m]: [{x:.6g}, {y:.6g}, {z:.6g}]")


def _link_hints(
    analysis: Analysis, spec: AssetSpec, section: TextSpan | None, start: int, end: int
) -> Iterator[ValueHint]:
    """Yield the computed masses of the links of an asset."""
    from simfoundry.lint.draft import pictured_asset
    from simfoundry.scene.mass_facts import mass_source
    from simfoundry.spec.diagnostics import SpecError

    shown = [(n, s) for n, s in _shown(section, start, end) if n in spec.links and spec.links[n].mass is None]
    if not shown or analysis.has_errors:
        return
    try:
        item = pictured_asset(analysis.loaded).objects[0]
    except SpecError:
        return
    masses = {link.name: link.mass for link in item.links}
    for name, span in shown:
        if name in masses:
            tooltip = f"Mass: {mass_source(analysis.loaded, item, name).replace('`', '')}"
            yield ValueHint(_after(span), f"{masses[name]:.3g} kg", tooltip)


def _expressions(analysis: Analysis, root: TextSpan, start: int, end: int) -> Iterator[ValueHint]:
    """Yield the values of the expressions with parameters in a range of the text."""
    text = analysis.lines.text
    values = {k: v for k, v in analysis.loaded.parameters.items() if isinstance(v, int | float)}
    todo = [root] if values and "$" in text[start:end] else []
    while todo:
        for _, span in todo.pop().entries():
            if span.end < start or span.outer > end:
                continue
            if span.members:
                todo.append(span)
            elif span.end - span.start <= MOST_EXPRESSION and "$" in (written := text[span.start : span.end]):
                expression = written.strip("'\"")
                if is_expression(expression):
                    try:
                        value = evaluate(expression, values)
                    except ParameterError:
                        continue
                    yield ValueHint(span.end, f"= {number(value)}", f"Value of {expression}")


def _after(span: TextSpan) -> int:
    """Return the place of a hint: after a value on one line, or after the key of a block."""
    if span.members and not span.flow and span.key >= 0:
        return span.key_end + 1  # the colon
    return span.end


def _number(value: float) -> str:
    return number(round(value, _DECIMALS) + 0.0)
