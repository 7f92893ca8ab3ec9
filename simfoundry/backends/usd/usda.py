"""Conversion of prims to USDA text, formatted like the output of USD's own writer."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import lru_cache
from typing import Any

from simfoundry.backends.artifact import number
from simfoundry.backends.usd.prims import Asset, Attribute, Prim, Targets

_STEP = "    "


def usda(root: Prim, custom_data: Mapping[str, Any]) -> bytes:
    """Return a layer in meters and kilograms with z up, with ``root`` as its default prim."""
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
    """Append metadata in parentheses, then properties, variants and children in braces."""
    inside = indent + _STEP
    metadata = list(_metadata(prim, inside))
    if metadata:
        lines += [f"{opening} (", *metadata]
        opening = f"{indent})"
    lines.append(f"{opening}{before_brace}{{")
    lines += [f"{inside}{_property(name, prim.properties[name])}" for name in sorted(prim.properties)]
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
        yield f"{indent}prepend apiSchemas = {_schemas(tuple(prim.schemas))}"
    if prim.custom_data:
        yield from _dictionary("customData", prim.custom_data, indent)
    if prim.kind:
        yield f"{indent}kind = {quoted(prim.kind)}"
    if prim.references:
        yield f"{indent}prepend references = {_list(prim.references)}"
    if prim.variants:
        yield from _dictionary("variants", {"variant": prim.selected}, indent)
        yield f'{indent}prepend variantSets = "variant"'


@lru_cache(maxsize=256)
def _schemas(names: tuple[str, ...]) -> str:
    return _list(map(quoted, names))


def _dictionary(name: str, entries: Mapping[str, Any], indent: str) -> Iterator[str]:
    yield f"{indent}{name} = {{"
    for key, value in sorted(entries.items()):
        match value:
            case dict():
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
    type_name, value, uniform, source = found
    declared = f"{custom}{'uniform ' if uniform else ''}{type_name} {name}"
    if source:
        return f"{declared}.connect = <{source}>"
    return declared if value is None else f"{declared} = {_TEXT[type(value)](value)}"


def _row(values: tuple[Any, ...]) -> str:
    """Format a vector of numbers, or a matrix of such rows."""
    items = map(number, values) if isinstance(values[0], float) else [_TEXT[type(v)](v) for v in values]
    return f"({', '.join(items)})"


def _list(items: Iterable[str]) -> str:
    return f"[{', '.join(items)}]"


@lru_cache(maxsize=16384)  # the same strings occur many times
def quoted(text: str) -> str:
    """Quote a string with the quotes that need the fewest escapes; triple quotes if it has several lines."""
    quote = "'" if '"' in text and "'" not in text else '"'
    fence = quote * 3 if "\n" in text else quote
    return f"{fence}{text.translate(_ESCAPES[quote])}{fence}"


def _escapes(quote: str) -> list[str]:
    """Return the escaped form of each ASCII character within the given quotes."""
    plain = {chr(k): chr(k) for k in range(128)}
    control = {chr(k): f"\\x{k:02x}" for k in (*range(32), 127) if k != ord("\n")}
    return list((plain | control | {"\\": "\\\\", quote: f"\\{quote}"}).values())


_ESCAPES = {quote: _escapes(quote) for quote in "'\""}

_TEXT: dict[type, Callable[[Any], str]] = {
    float: number,
    tuple: _row,
    list: lambda values: _list([_TEXT[type(v)](v) for v in values]),
    str: quoted,
    bool: lambda value: str(int(value)),
    int: str,
    Asset: lambda asset: f"@{asset.path}@",
}
"""The formatting function for each type of value."""
