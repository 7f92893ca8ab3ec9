"""Edits of the text of a scene with reuse, as a person makes them, each about one value, member, item or comment."""

from __future__ import annotations

import random
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from simfoundry.spec.yaml.text import Path_, parse
from tests.corpora.reuse_mutants import _end, lines_of
from tests.corpora.spec_mutants import Spot, at, spots

# Lists whose items are merged one by one.
SETS = ("relations", "no_contact")


@dataclass(frozen=True)
class Edit:
    """One edit of a text.

    Attributes:
        kind: What it is, for the table.
        paths: What it is about; another edit is independent if it is about none of these.
        apply: Returns the edited text.
        last: True if the edit must follow all others, because it renames what they may mention.
        shown: A description.
    """

    kind: str
    paths: frozenset[Path_]
    apply: Callable[[str], str]
    last: bool = False
    shown: str = field(default="", compare=False)

    def touches(self, other: Edit) -> bool:
        """Whether two edits are about one thing."""
        return any(a[: len(b)] == b[: len(a)] for a in self.paths for b in other.paths)


def edits(text: str, rng: random.Random, side: str) -> Iterator[Edit]:
    """Edits of a document; ``side`` makes new names unique."""
    found = [s for s in spots(parse(text).root) if s.path]
    yield from values(found, rng)
    yield from keys(found, rng)
    yield from new_members(found, rng, side)
    yield from removals(text, found)
    yield from new_names(found, side)
    yield from items(text, found, rng)
    yield from comments(text, found, side)


def values(found: list[Spot], rng: random.Random) -> Iterator[Edit]:
    """Other numbers, counts and expressions."""
    for s in found:
        plain, value = s.node.plain, s.node.value
        if not plain or s.node.children is not None or s.path[0] in (*SETS, "allow"):
            continue
        if "$" in plain:
            new = rng.choice([f"1.1 * ({plain})", f"{plain} / 2", "0.3"])
        elif isinstance(value, int) and not isinstance(value, bool) and set(s.path) & {"count", "stack", "size"}:
            new = str(value + rng.randrange(1, 4))
        elif isinstance(value, int | float) and not isinstance(value, bool):
            new = str(round(value * rng.choice((0.7, 0.9, 1.2)) + rng.choice((0.01, 0.02)), 4))
        else:
            continue
        if parse(new).data == value:
            continue
        whole = tuple(part for part in s.path if not isinstance(part, int))  # a list of numbers is one value
        yield set_scalar(s.path, whole, plain, new)


def set_scalar(path: Path_, whole: Path_, old: str, new: str) -> Edit:
    """The edit that replaces one scalar."""

    def apply(text: str) -> str:
        node = next(s.node for s in spots(parse(text).root) if s.path == path)
        changed = at(text, node.line, node.column, old, new)
        assert changed is not None, path
        return changed

    kind = str(path[0]) if path[0] != "objects" else str(path[2]) if len(path) > 2 else "object"
    return Edit(f"value of {kind}", frozenset({whole}), apply, shown=f"{'.'.join(map(str, path))}: {old} -> {new}")


def keys(found: list[Spot], rng: random.Random) -> Iterator[Edit]:
    """New fields of objects, templates, copies, and includes."""
    for s in found:
        if len(s.path) != 2 or not isinstance(s.node.children, dict):
            continue
        number = rng.randrange(10, 99)
        new = {
            "objects": f"friction: 0.{number}",
            "templates": f"restitution: 0.{number}",
            "frames": "",
            "materials": f"restitution: 0.{number}",
        }.get(str(s.path[0]), "")
        if new and new.partition(":")[0] not in s.node.children:
            yield insert_key(s.path, new)
        if s.path[0] == "include" and "parameters" not in s.node.children:
            yield insert_key(s.path, f"parameters: {{height: 0.{number}}}")
    for s in found:
        if s.path[-1] == "parameters" and len(s.path) == 3:
            yield insert_key(s.path, "height: 0.8")


def insert_key(path: Path_, new: str) -> Edit:
    """The edit that adds a key to a mapping."""
    key = new.partition(":")[0]

    def apply(text: str) -> str:
        spot = next(s for s in spots(parse(text).root) if s.path == path)
        lines = text.splitlines(keepends=True)
        row, column = spot.node.line, spot.node.column
        line = lines[row - 1]
        if line[column - 1] == "{":
            lines[row - 1] = f"{line[:column]}{new}, {line[column:]}"
        else:
            lines.insert(row - 1, " " * (column - 1) + new + "\n")
        return "".join(lines)

    return Edit(f"new key of {path[0]}", frozenset({(*path, key)}), apply, shown=f"{'.'.join(map(str, path))} += {new}")


MEMBERS = {
    "objects": ("{{shape: {{sphere: 0.0{}}}, mass: 0.1, pose: {{xyz: [0, 3, 1]}}}}",
                "{{shape: {{box: [0.1, 0.1, 0.0{}]}}, mass: 0.2, pose: {{xyz: [2, 3, 1]}}, repeat: {{count: 3}}}}"),
    "templates": ("{{shape: {{sphere: 0.0{}}}, friction: 0.3}}",),
    "parameters": ("0.{}",),
    "frames": ("{{xyz: [0, 0, 0.{}]}}",),
    "materials": ("{{friction: 0.{}}}",),
    "lights": ("{{type: point, intensity: 0.{}}}",),
    "include": ("{{scene: station.scene.yaml, pose: {{xyz: [{}, 4, 0]}}}}",),
}  # fmt: skip


def new_members(found: list[Spot], rng: random.Random, side: str) -> Iterator[Edit]:
    """New objects, templates, parameters, frames, materials, lights and includes, and new exceptions of copies."""
    for s in found:
        if len(s.path) == 1 and s.path[0] in MEMBERS and isinstance(s.node.children, dict):
            for form in MEMBERS[str(s.path[0])]:
                name = f"{rng.choice('abcxyz')}_{side}_{rng.randrange(1000)}"
                after = rng.choice(list(s.node.children))
                yield insert_member(str(s.path[0]), after, name, form.format(rng.randrange(10, 99)))
        if s.path[-1] == "repeat" and s.path[0] == "objects" and isinstance(s.node.children, dict):
            count = s.node.value.get("count")
            index = "1" if count is None or not isinstance(count, tuple) else "_".join("1" for _ in count)
            name = f"{s.path[1]}_{index}"
            yield insert_member("objects", str(s.path[1]), name, f"{{restitution: 0.{rng.randrange(10, 99)}}}")


def insert_member(section: str, after: str, name: str, value: str) -> Edit:
    """The edit that adds a member behind another one."""

    def apply(text: str) -> str:
        root = parse(text).root
        assert isinstance(root.children, dict)
        lines = text.splitlines(keepends=True)
        node = root.children[section]
        row, column = node.keys[after] if after in node.keys else next(reversed(node.keys.values()))
        lines.insert(_end(lines, row, column), f"{' ' * (column - 1)}{name}: {value}\n")
        return "".join(lines)

    return Edit(f"new in {section}", frozenset({(section, name)}), apply, shown=f"{section}.{name}: {value}")


def removals(text: str, found: list[Spot]) -> Iterator[Edit]:
    """Members that are gone, if nothing refers to them."""
    for s in found:
        if len(s.path) == 2 and s.path[0] in (*MEMBERS, "cameras") and s.key is not None:
            name = str(s.path[1])
            section = next(o.node for o in found if o.path == s.path[:1])
            rest = without_member(text, s.path)
            used = lines_of(rest, name) or any(str(n).startswith(f"{name}_") for n in section.children or ())
            if not used and f"${name}" not in rest and len(section.children or ()) > 2:
                shown = f"{s.path[0]}.{name} is gone"
                paths = frozenset({s.path, ("comment", *s.path), ("names", name)})
                yield Edit(f"less in {s.path[0]}", paths, _Removal(s.path), shown=shown)


@dataclass(frozen=True)
class _Removal:
    path: Path_

    def __call__(self, text: str) -> str:
        return without_member(text, self.path)


def without_member(text: str, path: Path_) -> str:
    """The text without a member that is written in lines of its own."""
    spot = next(s for s in spots(parse(text).root) if s.path == path)
    assert spot.key is not None
    lines = text.splitlines(keepends=True)
    return "".join([*lines[: spot.key[0] - 1], *lines[_end(lines, *spot.key) :]])


def new_names(found: list[Spot], side: str) -> Iterator[Edit]:
    """Other names of objects, templates, materials and frames, with everything that refers to them."""
    sections = ("objects", "templates", "materials", "frames", "include")
    if any(s.path == ("extends",) for s in found):
        return  # the name of an object of the base
    for s in found:
        if len(s.path) != 2 or s.path[0] not in sections or not isinstance(s.node.children, dict):
            continue
        name = str(s.path[1])
        twice = sum(o.path[1] == name for o in found if len(o.path) == 2) > 1
        keys = {str(p) for o in found for p in o.path[2:]}
        owners = [str(o.path[1]) for o in found if len(o.path) == 2 and o.path[0] in ("objects", "include")]
        if twice or name in keys or any(name.startswith(f"{owner}_") for owner in owners if owner != name):
            continue
        copies = [o.path for o in found if len(o.path) == 2 and str(o.path[1]).startswith(f"{name}_")]
        new = f"{name[:1]}_new_{side}"
        below = "(?:_[a-z0-9_]+)?" if s.path[0] == "include" else "(?:_[0-9]+)*"
        pattern = re.compile(rf"(?<![a-z0-9_$]){name}({below})(?![a-z0-9_])")
        yield Edit(f"new name in {s.path[0]}", frozenset({("names", name), *((*p, "#name") for p in copies)}),
                   _Renaming(pattern, new), True, f"{s.path[0]}.{name} -> {new}")  # fmt: skip


@dataclass(frozen=True)
class _Renaming:
    pattern: re.Pattern[str]
    new: str

    def __call__(self, text: str) -> str:
        lines = [line.partition(" #") for line in text.splitlines()]
        return (
            "\n".join(
                line if line.lstrip().startswith("#") else self.pattern.sub(rf"{self.new}\1", line) + mark + comment
                for line, mark, comment in lines
            )
            + "\n"
        )


def items(text: str, found: list[Spot], rng: random.Random) -> Iterator[Edit]:
    """Relations and pairs that come and go."""
    things = [str(s.path[1]) for s in found if s.path[0] == "objects" and len(s.path) == 2 and s.node.value is not None]
    data = parse(text).data
    for key in SETS:
        for item in data.get(key, ()):
            shown = item if isinstance(item, str) else f"[{', '.join(item)}]"
            yield Edit(
                f"less in {key}", frozenset({(key, _spelled(item))}), _Items(key, (), (shown,)), shown=f"- {shown}"
            )
        if len(things) > 1 and key in data:
            a, b = rng.sample(things, 2)
            new = f"NextTo({a}, {b})" if key == "relations" else f"[{a}, {b}]"
            path = (key, new if key == "relations" else _spelled((a, b)))
            yield Edit(f"more in {key}", frozenset({path}), _Items(key, (new,), ()), shown=f"+ {new}")


def _spelled(item: str | tuple[str, ...]) -> str:
    return item if isinstance(item, str) else " ".join(sorted(item))


@dataclass(frozen=True)
class _Items:
    """The edit that writes a list with other items, each on its own line."""

    key: str
    more: tuple[str, ...]
    less: tuple[str, ...]

    def __call__(self, text: str) -> str:
        root = parse(text).root
        assert isinstance(root.children, dict)
        lines = text.splitlines(keepends=True)
        if self.key not in root.children:
            return "".join([*lines, f"{self.key}:\n", *(f"  - {item}\n" for item in self.more)])
        row = root.keys[self.key][0]
        written = root.children[self.key].value
        kept = [item if isinstance(item, str) else f"[{', '.join(item)}]" for item in written]
        new = [item for item in (*kept, *self.more) if item not in self.less]
        comments = [line for line in lines[row : _end(lines, row, 1)] if line.lstrip().startswith("#")]
        block = [f"{self.key}:\n", *comments, *(f"  - {item}\n" for item in new)] if new else []
        return "".join([*lines[: row - 1], *block, *lines[_end(lines, row, 1) :]])


def comments(text: str, found: list[Spot], side: str) -> Iterator[Edit]:
    """Comments above members and beside lines."""
    lines = text.splitlines()
    for s in found:
        if s.key is None or len(s.path) != 2 or s.path[0] in SETS:
            continue
        row = lines[s.key[0] - 1]
        if row[: s.key[1] - 1].strip():
            continue
        shown = f"{'.'.join(map(str, s.path))} by {side}"
        yield Edit(
            "comment above", frozenset({("comment", *s.path, "above")}), _Comment(s.path, f"above {shown}", True)
        )
        if "#" not in row:
            yield Edit("comment beside", frozenset({("comment", *s.path)}), _Comment(s.path, f"beside {shown}", False))


@dataclass(frozen=True)
class _Comment:
    path: Path_
    words: str
    above: bool

    def __call__(self, text: str) -> str:
        found = next((s for s in spots(parse(text).root) if s.path == self.path), None)
        if found is None or found.key is None:
            return text
        lines = text.splitlines()
        row, column = found.key
        if self.above:
            lines.insert(row - 1, " " * (column - 1) + f"# {self.words}")
        else:
            lines[row - 1] += f"  # {self.words}"
        return "\n".join(lines) + "\n"
