"""Prims to the text of a layer, laid out as USD's own writer does."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from simfoundry.backends.artifact import number
from simfoundry.backends.usd.prims import Asset, Attribute, Prim, Targets

_CONTROL = re.compile(r"[\x00-\x09\x0b-\x1f\x7f]")
_STEP = "    "


def usda(root: Prim, custom_data: Mapping[str, Any]) -> bytes:
    """A layer in metres and kilograms with z up, of which ``root`` is the default prim."""
    head = [
        *(_dictionary("customLayerData", custom_data, _STEP) if custom_data else ()),
        f"{_STEP}defaultPrim = {quoted(root.name)}",
        f"{_STEP}kilogramsPerUnit = 1",
        f"{_STEP}metersPerUnit = 1",
        f'{_STEP}upAxis = "Z"',
    ]
    lines = ["#usda 1.0", "(", *head, ")", ""]
    _append_prim(lines, root, "")
    return "\n".join([*lines, "", ""]).encode()


def _append_prim(lines: list[str], prim: Prim, indent: str) -> None:
    kind = f"{prim.specifier} {prim.type_name}".rstrip()
    _append_body(lines, prim, f"{indent}{kind} {quoted(prim.name)}", "\n" + indent, indent)


def _append_body(lines: list[str], prim: Prim, opening: str, before_brace: str, indent: str) -> None:
    """Metadata in parentheses, then properties, variants and children in braces."""
    inside = indent + _STEP
    metadata = list(_metadata(prim, inside))
    if metadata:
        lines += [f"{opening} (", *metadata]
        opening = f"{indent})"
    lines.append(f"{opening}{before_brace}{{")
    lines += [f"{inside}{_property(name, found)}" for name, found in sorted(prim.properties.items())]
    if prim.variants:
        lines.append(f'{inside}variantSet "variant" = {{')
        for name, variant in sorted(prim.variants.items()):
            _append_body(lines, variant, f"{inside}{_STEP}{quoted(name)}", " ", inside + _STEP)
        lines.append(f"{inside}}}")
    gap = bool(prim.properties)
    for child in prim.children.values():
        if gap:
            lines.append("")
        _append_prim(lines, child, inside)
        gap = True
    lines.append(f"{indent}}}")


def _metadata(prim: Prim, indent: str) -> Iterator[str]:
    if prim.schemas:
        yield f"{indent}prepend apiSchemas = {_list(map(quoted, prim.schemas))}"
    if prim.custom_data:
        yield from _dictionary("customData", prim.custom_data, indent)
    if prim.kind:
        yield f"{indent}kind = {quoted(prim.kind)}"
    if prim.references:
        yield f"{indent}prepend references = {_list(prim.references)}"
    if prim.variants:
        yield from _dictionary("variants", {"variant": prim.selected}, indent)
        yield f'{indent}prepend variantSets = "variant"'


def _dictionary(name: str, entries: Mapping[str, Any], indent: str) -> Iterator[str]:
    yield f"{indent}{name} = {{"
    for key, value in sorted(entries.items()):
        match value:
            case Mapping():
                yield from _dictionary(f"dictionary {key}", value, indent + _STEP)
            case str():
                yield f"{indent}{_STEP}string {key} = {quoted(value)}"
            case _:
                yield f"{indent}{_STEP}string[] {key} = {_list(map(quoted, value))}"
    yield f"{indent}}}"


def _property(name: str, found: Attribute | Targets) -> str:
    custom = "custom " if name.startswith("simfoundry:") else ""
    if isinstance(found, Targets):
        paths = [f"<{path}>" for path in found.paths]
        return f"{custom}rel {name} = {paths[0] if len(paths) == 1 else _list(paths)}"
    declared = f"{custom}{'uniform ' if found.uniform else ''}{found.type_name} {name}"
    if found.source:
        return f"{declared}.connect = <{found.source}>"
    return declared if found.value is None else f"{declared} = {_value(found.value)}"


def _value(value: Any) -> str:
    match value:
        case bool() | int():
            return str(int(value))
        case float():
            return number(value)
        case str():
            return quoted(value)
        case list():
            return _list(map(_value, value))
        case Asset():
            return f"@{value.path}@"
    return f"({', '.join([_value(v) for v in value])})"


def _list(items: Iterable[str]) -> str:
    return f"[{', '.join(items)}]"


def quoted(text: str) -> str:
    """A text in the quotes that need the fewest escapes; in three of them where it has several lines."""
    quote = "'" if '"' in text and "'" not in text else '"'
    escaped = text.replace("\\", "\\\\").replace(quote, f"\\{quote}")
    escaped = _CONTROL.sub(lambda found: f"\\x{ord(found.group()):02x}", escaped)
    fence = quote * 3 if "\n" in text else quote
    return f"{fence}{escaped}{fence}"
