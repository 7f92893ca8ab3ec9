"""Random edits of documents as plain data, for the tests of diffs and merges."""

from __future__ import annotations

import random
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

Path_ = tuple[str, ...]

SECTIONS = ("objects", "materials", "lights")
FIXED = ("quat_wxyz", "simfoundry", "conflicts", "range", "value", "grid", "size", "limits", "limits_deg")
"""Keys whose values cannot be scaled alone and stay valid, or are left to other tests."""


@dataclass(frozen=True)
class Edit:
    """One edit: ``set`` a value, ``remove`` or ``add`` a member (behind ``after``), ``say`` or ``unsay`` a relation."""

    kind: str
    path: Path_
    value: Any = None
    after: str | None = None

    def touches(self, other: Edit) -> bool:
        """Whether two edits are about one thing."""
        if "say" in self.kind and "say" in other.kind:
            return bool(self.value == other.value)
        length = min(len(self.path), len(other.path))
        return self.path[:length] == other.path[:length]


def edited(data: Any, edits: list[Edit]) -> Any:
    """The data with the edits; what stood there stays as it was."""
    for edit in edits:
        data = _edited(data, edit.path, edit)
    return data


def scalings(data: Any, rng: random.Random, path: Path_ = ()) -> Iterator[Edit]:
    """For each number, and list of numbers, of a document another one that is as valid."""
    if isinstance(data, dict):
        for key, item in data.items():
            if key not in FIXED:
                yield from scalings(item, rng, (*path, key))
    elif _scaled(data, 0.5) != data:
        yield Edit("set", path, _scaled(data, rng.choice((0.97, 0.98, 0.99))))


def structural(data: Any, rng: random.Random, side: str) -> Iterator[Edit]:
    """Members that come and go, and relations."""
    for section in SECTIONS:
        names = list(data.get(section, {}))
        for name in names:
            yield Edit("remove", (section, name))
        if names:
            name = f"{rng.choice('abcxyz')}_{side}_{rng.randrange(1000)}"
            yield Edit("add", (section, name), _member(section, rng), rng.choice([None, *names]))
    things = list(data.get("objects", {}))
    if len(things) > 1:
        for text in data.get("relations", ()):
            yield Edit("unsay", ("relations",), text)
        yield Edit("say", ("relations",), f"NextTo({', '.join(rng.sample(things, 2))})")


def independent(data: Any, rng: random.Random) -> tuple[list[Edit], list[Edit]]:
    """Edits of two sides of which none of the one touches any of the other."""
    found = [*scalings(data, rng), *structural(data, rng, "o"), *structural(data, rng, "t")]
    rng.shuffle(found)
    sides: tuple[list[Edit], list[Edit]] = ([], [])
    for edit in found[: rng.randrange(2, 14)]:
        if not any(edit.touches(e) for side in sides for e in side):
            sides[rng.randrange(2)].append(edit)
    return sides


def clashing(data: Any, rng: random.Random) -> tuple[list[Edit], list[Edit]]:
    """Edits of two sides that may meet; those of one side do not."""
    sides: tuple[list[Edit], list[Edit]] = ([], [])
    for name, side in zip("ot", sides, strict=True):
        found = [*scalings(data, rng), *structural(data, rng, name)]
        for edit in rng.sample(found, min(len(found), rng.randrange(1, 8))):
            if not any(edit.touches(e) for e in side):
                side.append(edit)
    return sides


def _edited(data: Any, path: Path_, edit: Edit) -> Any:
    if edit.kind in ("say", "unsay"):
        relations = tuple(t for t in data.get("relations", ()) if t != edit.value)
        return {**data, "relations": relations if edit.kind == "unsay" else (*relations, edit.value)}
    if len(path) > 1:
        return {**data, path[0]: _edited(data[path[0]], path[1:], edit)}
    if edit.kind == "set":
        return {**data, path[0]: edit.value}
    if edit.kind == "remove":
        return {key: item for key, item in data.items() if key != path[0]}
    before = [] if edit.after is None else list(data)[: list(data).index(edit.after) + 1] if edit.after in data else []
    first = {key: data[key] for key in before}
    return {**first, path[0]: edit.value, **data}


def _member(section: str, rng: random.Random) -> dict[str, Any]:
    number = round(rng.uniform(0.1, 0.9), 3)
    match section:
        case "objects":
            return {"shape": {"sphere": number}, "mass": round(rng.uniform(100, 900) * number**3, 3), "fixed": False}
        case "materials":
            return {"friction": number}
    return {"type": "dome", "intensity": number}


def _scaled(value: Any, factor: float) -> Any:
    match value:
        case bool():
            return value
        case float():
            return round(value * factor, 6)
        case int():
            return value * factor if abs(value) < 10 else value
        case tuple() if value and all(type(v) in (int, float) for v in value):
            return tuple(round(v * factor, 6) for v in value)
    return value
