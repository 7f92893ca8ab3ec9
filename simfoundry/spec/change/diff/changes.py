"""Compute the changes that turn one document into another.

Documents are plain data: mappings with string keys, tuples, and scalars. Members of named mappings are matched by
name. If one member disappears and a nearly equal one appears, the pair is treated as a rename. Lists are replaced as a
whole, except for lists of expressions (``relations``, ``all``, ``any``) and lists of pairs (``no_contact``), which are
compared as sets: each expression or pair is a member whose name is its text. ``1`` and ``1.0`` are considered equal.
"""

from __future__ import annotations

import difflib
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any

from simfoundry.spec.change.diff.generated import generated_names
from simfoundry.spec.compose.parameters import PARAMETER, holds_text, is_expression
from simfoundry.spec.models.types import EXPRESSIONS, REFERENCES

Path_ = tuple[str, ...]

# Keys whose values are unordered lists of expressions.
EXPRESSION_LISTS = ("relations", "all", "any")

# Keys whose values are lists of pairs. Neither the lists nor the pairs are ordered.
PAIR_LISTS = ("no_contact",)


@dataclass(frozen=True)
class Set:
    """A change of the value at ``path`` from ``old`` to ``new``."""

    path: Path_
    old: Any
    new: Any


@dataclass(frozen=True)
class Add:
    """The addition of a member at ``path``. Its place in the mapping is the zero-based index ``position``."""

    path: Path_
    value: Any
    position: int


@dataclass(frozen=True)
class Remove:
    """The removal of the member at ``path``."""

    path: Path_
    old: Any


@dataclass(frozen=True)
class Reorder:
    """A new order for the members of the mapping at ``section``."""

    section: Path_
    order: tuple[str, ...]


@dataclass(frozen=True)
class Rename:
    """The renaming of a member in the mapping at ``section``, including all references to the member."""

    section: Path_
    old: str
    new: str


Change = Set | Add | Remove | Rename | Reorder


def diff(a: Any, b: Any) -> tuple[Change, ...]:
    """Return the changes that turn ``a`` into ``b``, including changes to the order of keys.

    Renames come first. The paths and old values in all other changes use the new names.
    """
    renames = find_renames(a, b)
    return (*renames, *_value(renamed(a, renames) if renames else a, b, ()))


def to_json(change: Change) -> dict[str, Any]:
    """Return a change as plain data, including its ``kind``."""
    return {"kind": type(change).__name__.lower(), **asdict(change)}


def members(value: Any, path: Path_) -> dict[str, Any] | None:
    """Return the members of a mapping, keyed by name, or of a list of expressions, keyed by text.

    Returns None for any other value.
    """
    if isinstance(value, dict):
        return value
    if path and path[-1] in (*EXPRESSION_LISTS, *PAIR_LISTS) and isinstance(value, tuple | list):
        keyed = {expression(item): item for item in value}
        return keyed if len(keyed) == len(value) else None
    return None


def expression(item: Any) -> str:
    """Format a goal or a pair as a string, such as ``any(OnTop(cup, plate), not Open(box))`` or ``cup and plate``."""
    match item:
        case str():
            return item
        case (str(), str()):
            return " and ".join(sorted(item))
        case {"not": inner}:
            return f"not {expression(inner)}"
        case dict() if len(item) == 1:
            key, inner = next(iter(item.items()))
            parts = inner if isinstance(inner, tuple | list) else (inner,)
            return f"{key}({', '.join(map(expression, parts))})"
    return repr(item)


def _value(a: Any, b: Any, path: Path_) -> Iterator[Change]:
    before, after = members(a, path), members(b, path)
    # Shapes of different kinds have no key in common and are replaced as a whole.
    other_shape = path[-1:] == ("shape",) and isinstance(a, dict) and isinstance(b, dict) and not a.keys() & b.keys()
    if before is None or after is None or isinstance(a, dict) != isinstance(b, dict) or other_shape:
        if not same(a, b):
            yield Set(path, a, b)
        return
    for key, old in before.items():
        if key not in after:
            yield Remove((*path, key), old)
        else:
            yield from _value(old, after[key], (*path, key))
    order = [key for key in before if key in after]  # the order after these removals and additions
    for position, (key, new) in enumerate(after.items()):
        if key not in before:
            yield Add((*path, key), new, position)
            order.insert(position, key)
    if order != list(after):
        yield Reorder(path, tuple(after))


# Document sections with named members, in the order in which changes are shown.
NAMED = (
    *("objects", "robots", "links", "joints", "sites", "actuators", "sensors", "subtasks", "cameras", "lights"),
    *("materials", "frames", "templates", "include"),
)

# Keys whose value is a mapping with named members.
SECTIONS = (*NAMED, "axes", "parts", "compound", "variants", "place", "pose", "splits", "sources")

# Minimum fraction of equal values for which two members are treated as a rename.
ALIKE = 0.6

# Keys that identify a member. If the value of any of these keys differs, the members are different objects.
IDENTITY = ("shape", "asset", "mesh", "model")

# Maximum number of pairs whose similarity is computed; if there are more pairs, only equal members match.
MAX_PAIRS = 40_000

# Keys whose value names a member, each with the sibling key whose mapping contains that member.
BESIDE = {"variant": "variants"}

_ARGUMENT = re.compile(r"(?<=[(,])(\s*)([a-z][a-z0-9_]*)(?=\s*[.,)])")


def find_renames(a: Any, b: Any) -> list[Rename]:
    """Return the members of ``a`` that were renamed in ``b``. Within each section, the best match comes first."""
    found: dict[tuple[Path_, str], Rename] = {}
    while True:
        # Each rename may make references match and thus reveal further renames, so repeat until no more are found.
        known = len(found)
        spaces = {(_space(r.section), r.old, r.new) for r in found.values()}
        # Sections that define names come first, before those that only refer to them.
        present = renamed(a, found.values()) if found else a
        for path, x, y in sorted(_sections(present, b, ()), key=lambda s: len(s[0])):
            for rename in _matches(path, x, y):
                meaning = (_space(path), rename.old, rename.new)
                if not meaning[0] or meaning not in spaces:
                    found.setdefault((path, rename.old), rename)
                    spaces.add(meaning)
        if len(found) == known:
            return list(found.values())


def renamed(data: Any, renames: Iterable[Rename]) -> Any:
    """Return a copy of ``data`` in which members and references to them are renamed."""
    local: dict[Path_, dict[str, str]] = {}
    spaces: dict[str, dict[str, str]] = {}
    renames = list(renames)
    generated = (Rename(*new) for r in renames for new in generated_names(data, r.section, r.old, r.new))
    for rename in (*renames, *generated):
        local.setdefault(rename.section, {})[rename.old] = rename.new
        spaces.setdefault(_space(rename.section), {}).setdefault(rename.old, rename.new)
    spaces.pop("", None)
    return _renamed(data, (), local, spaces)


def same(a: Any, b: Any) -> bool:
    """Return True if two values are equal, including key order. ``1`` equals ``1.0`` but not ``true``."""
    if isinstance(a, dict):
        return isinstance(b, dict) and list(a) == list(b) and all(same(a[key], b[key]) for key in a)
    if isinstance(a, tuple | list):
        return isinstance(b, tuple | list) and len(a) == len(b) and all(map(same, a, b))
    if isinstance(a, bool) or isinstance(b, bool):
        return a is b
    return bool(a == b) or (a != a and b != b)


def copied(value: Any, scalar: Callable[[Any], Any] = lambda item: item) -> Any:
    """Copy a value with its nested mappings and lists, applying ``scalar`` to all other values."""
    match value:
        case dict():
            return {key: copied(item, scalar) for key, item in value.items()}
        case tuple() | list():
            return tuple(copied(item, scalar) for item in value)
    return scalar(value)


def _sections(a: Any, b: Any, path: Path_) -> Iterator[tuple[Path_, dict[str, Any], dict[str, Any]]]:
    """Yield every named mapping that exists at the same path in both documents."""
    if not (isinstance(a, dict) and isinstance(b, dict)):
        return
    if path and path[-1] in SECTIONS:
        yield path, a, b
    for key, value in a.items():
        if isinstance(value, dict) and key in b:
            yield from _sections(value, b[key], (*path, key))


def _matches(path: Path_, a: dict[str, Any], b: dict[str, Any]) -> Iterator[Rename]:
    """Yield one-to-one matches between members that exist only in ``a`` and only in ``b``, most similar pairs first."""
    gone = [_Member(name, value) for name, value in a.items() if name not in b and isinstance(value, dict) and value]
    come = [_Member(name, value) for name, value in b.items() if name not in a and isinstance(value, dict) and value]
    if len(gone) * len(come) > MAX_PAIRS:
        equal: dict[frozenset[Any], list[_Member]] = {}
        for new in come:
            equal.setdefault(new.leaves, []).append(new)
        for old in gone:
            if equal.get(old.leaves):
                yield Rename(path, old.name, equal[old.leaves].pop(0).name)
        return
    scored = []
    for i, old in enumerate(gone):
        for k, new in enumerate(come):
            if (likeness := _likeness(old, new)) >= ALIKE:
                names = difflib.SequenceMatcher(None, old.name, new.name).ratio()  # breaks ties
                scored.append((-likeness, -names, i, k))
    taken: set[str] = set()
    for *_, i, k in sorted(scored):
        if gone[i].name not in taken and come[k].name not in taken:
            taken |= {gone[i].name, come[k].name}
            yield Rename(path, gone[i].name, come[k].name)


class _Member:
    """A named member and its values, keyed by path."""

    def __init__(self, name: str, value: dict[str, Any]) -> None:
        self.name, self.value = name, value
        plain = ((path, v if isinstance(v, str | int | float | None) else repr(v)) for path, v in leaves(value))
        self.leaves = frozenset(plain)
        self.paths = frozenset(path for path, _ in self.leaves)


def _likeness(old: _Member, new: _Member) -> float:
    """Return the fraction of values in which two members agree.

    The result is 0 if the members are too different or do not have the same shape, asset, mesh or model.
    """
    common = len(old.leaves & new.leaves)
    if common < ALIKE * max(len(old.leaves), len(new.leaves)):
        return 0.0
    same_identity = all(same(old.value.get(key), new.value.get(key)) for key in IDENTITY)
    return common / len(old.paths | new.paths) if same_identity else 0.0


def leaves(value: Any, path: Path_ = ()) -> Iterator[tuple[Path_, Any]]:
    """Yield the path and value of everything in ``value`` except nonempty mappings."""
    if isinstance(value, dict) and value:
        for key, item in value.items():
            yield from leaves(item, (*path, key))
    else:
        yield path, value


def _space(section: Path_) -> str:
    """Return the section that defines the names in a mapping, or an empty string if the names are never referenced."""
    if section[-1:] == ("objects",) or section[-2:-1] == ("start",):
        return "objects"
    return section[0] if len(section) == 1 else ""


def _renamed(value: Any, path: Path_, local: dict[Path_, dict[str, str]], spaces: dict[str, dict[str, str]]) -> Any:
    """Rename the references in the value at ``path``. The names in ``path`` itself have already been renamed."""
    if isinstance(value, dict):
        mapping: dict[str, Any] = value
        if path == ("conflicts",) or (len(path) == 2 and path[0] == "allow"):
            given = {key: _path_renamed(key, local, spaces if path[0] == "allow" else {}) for key in mapping}
        else:
            given = {**spaces.get(_space(path), {}), **local.get(path, {})}
        names = _new_names(mapping, given)
        items = ((names.get(key, key), item) for key, item in mapping.items())
        return {key: _renamed(item, (*path, key), local, spaces) for key, item in items}
    key = path[-1] if local and path else ""
    if key in BESIDE:
        return local.get((*path[:-1], BESIDE[key]), {}).get(value, value) if isinstance(value, str) else value

    def scalar(item: Any) -> Any:
        if "parameters" in spaces and isinstance(item, str) and is_expression(item) and not holds_text(path):
            return PARAMETER.sub(lambda m: f"${_name(m[1], ('parameters',), spaces)}", item)
        return renamed_reference(key, item, spaces)

    return copied(value, scalar)


def renamed_reference(key: str, value: Any, spaces: Mapping[str, Mapping[str, str]]) -> Any:
    """Rename the names in a scalar, such as ``cup`` in ``on: cup`` or ``OnTop(cup, desk)``.

    Args:
        key: The key whose value is the scalar, or a list that contains it.
        value: The scalar.
        spaces: The new names, by section and old name.
    """
    if key in REFERENCES:
        return _reference(value, REFERENCES[key], spaces)
    return _expression(value, spaces) if key in EXPRESSIONS else value


def names_in(key: str, text: str) -> list[str]:
    """Return the names of objects and robots in a scalar, such as ``cup`` and ``desk`` in ``OnTop(cup, desk)``."""
    if key in EXPRESSIONS:
        return [match[2] for match in _ARGUMENT.finditer(text)]
    return [text.partition(".")[0]] if key in REFERENCES else []


def _path_renamed(text: str, local: dict[Path_, dict[str, str]], spaces: dict[str, dict[str, str]]) -> str:
    """Rename the members in a dotted path. A path that consists of a single name is looked up in ``spaces``."""
    parts = text.split(".")
    if len(parts) == 1:
        return _name(text, NAMED, spaces)
    for k in range(1, len(parts)):
        name, again, number = parts[k].partition(" #")  # conflicts at the same path are numbered
        parts[k] = local.get(tuple(parts[:k]), {}).get(name, name) + again + number
    return ".".join(parts)


def _new_names(mapping: dict[str, Any], names: dict[str, str]) -> dict[str, str]:
    """Return the new names of keys in a mapping, omitting renames that would give two keys the same name."""
    kept = {key: names[key] for key in mapping if key in names}
    while True:
        count = Counter(kept.get(key, key) for key in mapping) if kept else {}
        clear = {key: new for key, new in kept.items() if count[new] == 1}
        if len(clear) == len(kept):
            return kept
        kept = clear


def _expression(value: Any, spaces: Mapping[str, Mapping[str, str]]) -> Any:
    """Rename the arguments of an expression."""
    if not isinstance(value, str):
        return value
    return _ARGUMENT.sub(lambda m: m[1] + _name(m[2], ("objects", "robots"), spaces), value)


def _reference(value: Any, sections: tuple[str, ...], spaces: Mapping[str, Mapping[str, str]]) -> Any:
    if not isinstance(value, str):
        return value
    head, dot, tail = value.partition(".")
    return _name(head, sections, spaces) + dot + tail


def _name(name: str, sections: tuple[str, ...], spaces: Mapping[str, Mapping[str, str]]) -> str:
    return next((spaces[s][name] for s in sections if name in spaces.get(s, {})), name)
