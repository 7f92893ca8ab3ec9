"""USD prims as plain Python objects, and their text format.

:func:`usda` formats prims like USD's own writer, but is five times as fast as authoring through USD layers. Vectors,
quaternions (w first) and matrix rows are tuples, and arrays are lists.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, NamedTuple

from simfoundry.backends.artifact import number, rounded
from simfoundry.geometry.frames import IDENTITY, Pose


class Attribute(NamedTuple):
    """A prim attribute with its USD type name.

    The value is None if no value is authored or if the attribute is connected to the ``source`` property.
    """

    type_name: str
    value: Any
    uniform: bool = False
    source: str = ""


class Asset(NamedTuple):
    """A file path as an attribute value."""

    path: str


class Targets(NamedTuple):
    """The targets of a relationship, as paths on the stage."""

    value: tuple[str, ...]


@dataclass(eq=False, slots=True)
class Prim:
    """A prim under construction.

    ``path`` is the prim's path on the stage, without variant selections. ``references`` are in USD syntax. A prim with
    ``variants`` has one variant set named ``variant``, in which one variant is ``selected``. Each variant is a prim
    with its own name and type.
    """

    name: str
    type_name: str
    path: str
    specifier: str = "def"
    kind: str = ""
    schemas: list[str] = field(default_factory=list)
    custom_data: dict[str, Any] = field(default_factory=dict)
    references: list[str] = field(default_factory=list)
    properties: dict[str, Attribute | Targets] = field(default_factory=dict)
    children: dict[str, Prim] = field(default_factory=dict)
    variants: dict[str, Prim] = field(default_factory=dict)
    selected: str = ""

    def variant(self, name: str) -> Prim:
        """Add the variant ``name``, whose contents exist on the stage only if it is selected."""
        self.variants[name] = Prim(self.name, self.type_name, self.path)
        return self.variants[name]

    def define(self, name: str, type_name: str, schemas: Sequence[str] = (), specifier: str = "def") -> Prim:
        """Define a child prim of the given type and apply API schemas, including schemas that are not registered."""
        self.children[name] = Prim(name, type_name, f"{self.path}/{name}", specifier, schemas=list(schemas))
        return self.children[name]

    def attribute(self, name: str, type_name: str, value: object, *, uniform: bool = False) -> None:
        """Author an attribute. Names that start with ``simfoundry:`` are custom because no schema defines them."""
        self.properties[name] = Attribute(type_name, value, uniform)

    def floats(self, value: float, *names: str) -> None:
        """Author several single-precision attributes with the same value, rounded to twelve digits."""
        for name in names:
            self.attribute(name, "float", rounded(value))

    def connect(self, name: str, type_name: str, source: str) -> None:
        """Author an attribute that is connected to the property at the path ``source``."""
        self.properties[name] = Attribute(type_name, None, source=source)

    def relate(self, name: str, targets: Iterable[Prim | str]) -> None:
        """Author a relationship to other prims or stage paths."""
        self.properties[name] = Targets(tuple(t if isinstance(t, str) else t.path for t in targets))

    def place(self, pose: Pose, scale: Sequence[float] | None = None) -> None:
        """Set the pose relative to the parent in double precision. The ``scale`` is applied first."""
        p, q = ((), ()) if pose is IDENTITY else (pose.p.tolist(), pose.q.tolist())
        operations: dict[str, tuple[str, tuple[float, ...]]] = {}
        if any(p):
            operations["xformOp:translate"] = "double3", tuple([settled(v) for v in p])
        if any(q[1:]):
            operations["xformOp:orient"] = "quatd", quat(q)
        if scale is not None:
            operations["xformOp:scale"] = "double3", tuple([rounded(v) for v in scale])
        for name, (type_name, value) in operations.items():
            self.attribute(name, type_name, value)
        if operations:
            self.attribute("xformOpOrder", "token[]", list(operations), uniform=True)


def settled(value: float) -> float:
    """Round a coordinate [m] or quaternion component to twelve decimals so that rounding noise becomes zero."""
    return round(float(value), 12) + 0.0


def vec3(values: Iterable[float]) -> tuple[float, ...]:
    """Return three values in single precision. Values out of range become infinite, as they do for readers."""
    return tuple([v if abs(v) < _MOST else math.copysign(math.inf, v) for v in map(rounded, values)])


# The largest finite single-precision number.
_MOST = 3.4028235e38


def quat(q: Iterable[float]) -> tuple[float, ...]:
    """Return a wxyz quaternion rounded to twelve decimals."""
    return tuple([settled(v) for v in q])


_STEP = "    "


def usda(root: Prim, custom_data: Mapping[str, Any]) -> bytes:
    """Return the text of a layer in meters and kilograms with z up, whose default prim is ``root``."""
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
        paths = [f"<{path}>" for path in found.value]
        return f"{custom}rel {name} = {paths[0] if len(paths) == 1 else _list(paths)}"
    type_name, value, uniform, source = found
    declared = f"{custom}{'uniform ' if uniform else ''}{type_name} {name}"
    if source:
        return f"{declared}.connect = <{source}>"
    return declared if value is None else f"{declared} = {_TEXT[type(value)](value)}"


def _row(values: tuple[Any, ...]) -> str:
    """Format a vector of numbers, or a matrix given as a tuple of rows."""
    items = map(number, values) if isinstance(values[0], float) else [_TEXT[type(v)](v) for v in values]
    return f"({', '.join(items)})"


def _list(items: Iterable[str]) -> str:
    return f"[{', '.join(items)}]"


@lru_cache(maxsize=16384)  # the same strings occur repeatedly
def quoted(text: str) -> str:
    """Quote a string using the quotes that require the fewest escapes, or triple quotes if it spans several lines."""
    quote = "'" if '"' in text and "'" not in text else '"'
    fence = quote * 3 if "\n" in text else quote
    return f"{fence}{text.translate(_ESCAPES[quote])}{fence}"


def _escapes(quote: str) -> list[str]:
    """Return the escape sequence for each ASCII character inside the given quotes."""
    plain = {chr(k): chr(k) for k in range(128)}
    control = {chr(k): f"\\x{k:02x}" for k in (*range(32), 127) if k != ord("\n")}
    return list((plain | control | {"\\": "\\\\", quote: f"\\{quote}"}).values())


_ESCAPES = {quote: _escapes(quote) for quote in "'\""}

# The formatting function for each type of value.
_TEXT: dict[type, Callable[[Any], str]] = {
    float: number,
    tuple: _row,
    list: lambda values: _list([_TEXT[type(v)](v) for v in values]),
    str: quoted,
    bool: lambda value: str(int(value)),
    int: str,
    Asset: lambda asset: f"@{asset.path}@",
}
