"""Single-field corruptions of spec documents, each with the line that a finding must point to."""

from __future__ import annotations

import random
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from simfoundry.spec.yaml.nodes import Node
from simfoundry.spec.yaml.text import Path_, parse

POSITIVE = (
    "mass",
    "density",
    "radius",
    "height",
    "sphere",
    "fx",
    "fy",
    "value",
    "scale",
    "reach",
    "opening",
    "control_hz",
)
NOT_NEGATIVE = ("friction", "restitution", "damping", "armature", "intensity", "gap")
WHOLE = ("horizon", "count", "seed")
FILES = ("asset", "visual", "mesh", "scene", "twin", "extends", "image", "truth")
NAMES = (
    "material",
    "parent",
    "child",
    "viewpoint",
    "on",
    "inside",
    "left_of",
    "right_of",
    "in_front_of",
    "behind",
    "anchor",
    "like",
    "frame",
    "seen_from",
    "look_at",
)
CHOICES = ("collision", "solid", "type", "simfoundry", "proposals")
ARITY = (
    "xyz",
    "look_at",
    "rpy_deg",
    "quat_wxyz",
    "box",
    "size",
    "axis",
    "limits",
    "limits_deg",
    "range",
    "gravity",
    "color",
)
CALL = re.compile(r"[A-Z][A-Za-z]+\([^()]*\)")


@dataclass(frozen=True)
class Spot:
    """A value of a document: its path, its node, and the place of its key."""

    path: Path_
    node: Node
    key: tuple[int, int] | None

    @property
    def name(self) -> str:
        """The key that it stands under, whatever list it is in."""
        return next((str(p) for p in reversed(self.path) if isinstance(p, str)), "")


@dataclass(frozen=True)
class Mutant:
    """A corrupted text, what was done to it, and the line where it was done.

    A finding may also be in one of the lines ``uses``, which use what was removed. If ``user`` is set, it is the name
    of a document that uses the corrupted one and is checked instead.
    """

    kind: str
    text: str
    line: int
    done: str
    uses: frozenset[int] = frozenset()
    user: str = ""

    def places(self, file: str) -> set[tuple[str, int]]:
        """The files and lines that a finding may point to, given the name of the corrupted document."""
        return {(file, line) for line in (self.line, *self.uses)}


def spots(node: Node, path: Path_ = (), key: tuple[int, int] | None = None) -> Iterator[Spot]:
    """Every value of a document."""
    yield Spot(path, node, key)
    if isinstance(node.children, dict):
        for name, child in node.children.items():
            yield from spots(child, (*path, name), node.keys[name])
    elif isinstance(node.children, list):
        for k, child in enumerate(node.children):
            yield from spots(child, (*path, k))


def at(text: str, line: int, column: int, old: str, new: str) -> str | None:
    """The text with ``old`` at a place replaced by ``new``; None where it does not stand there."""
    lines = text.splitlines(keepends=True)
    start = column - 1
    if lines[line - 1][start : start + len(old)] != old:
        return None
    lines[line - 1] = lines[line - 1][:start] + new + lines[line - 1][start + len(old) :]
    return "".join(lines)


Candidate = tuple[Spot, str, str]
"""A place, what stands there, and what shall stand there."""


def scalars(found: list[Spot]) -> Iterator[Spot]:
    return (s for s in found if s.node.plain and s.node.children is None)


def numbers(found: list[Spot]) -> Iterator[Spot]:
    return (s for s in scalars(found) if isinstance(s.node.value, int | float) and not isinstance(s.node.value, bool))


def wrong_type(found: list[Spot], rng: random.Random) -> Iterator[Candidate]:
    """A number becomes a text or a mapping, a truth a number, a name a list."""
    for s in numbers(found):
        if "conflicts" not in s.path:
            yield s, s.node.plain, rng.choice(["heavy", "{a: 1}", "true", "[[1]]", '"1"'])
    for s in scalars(found):
        if s.name in (*NAMES, *FILES, "name") and isinstance(s.path[-1], str):
            yield s, s.node.plain, rng.choice(["[a]", "3", "true", "{a: 1}"])
        if isinstance(s.node.value, bool):
            yield s, s.node.plain, rng.choice(["yes", "1", "[true]"])


def out_of_range(found: list[Spot], rng: random.Random) -> Iterator[Candidate]:
    """A number that no such quantity can have."""
    for s in numbers(found):
        own = s.path[-1]
        if own in POSITIVE:
            yield s, s.node.plain, rng.choice(["0", "-1", ".nan", ".inf"])
        elif own in NOT_NEGATIVE:
            yield s, s.node.plain, rng.choice(["-0.1", ".nan", "-.inf"])
        elif s.name in ("box", "size", "grid") and isinstance(own, int):
            yield s, s.node.plain, rng.choice(["0", "-0.5"])
        elif s.name == "color" and isinstance(own, int):
            yield s, s.node.plain, rng.choice(["1.5", "-0.1", "255"])
        elif own in WHOLE:
            yield s, s.node.plain, rng.choice(["-3", "1.5"])
        elif s.name in ARITY:
            yield s, s.node.plain, rng.choice([".nan", ".inf"])


def wrong_choice(found: list[Spot], rng: random.Random) -> Iterator[Candidate]:
    """A word that is not among the valid ones."""
    for s in scalars(found):
        if s.path[-1:] and s.path[-1] in CHOICES and "objects" not in s.path[:1]:
            yield s, s.node.plain, s.node.plain + rng.choice(["x", "_z"])


def dangling_name(found: list[Spot], rng: random.Random) -> Iterator[Candidate]:
    """A name that nothing has."""
    for s in scalars(found):
        if s.path and s.path[-1] in NAMES and isinstance(s.node.value, str):
            yield (
                s,
                s.node.plain,
                _typo(s.node.plain.split(".")[0], rng)
                + s.node.plain.partition(".")[1]
                + s.node.plain.partition(".")[2],
            )
        if CALL.fullmatch(s.node.plain):
            head, _, inside = s.node.plain.partition("(")
            first = inside.rstrip(")").split(",")[0].strip()
            yield s, head + "(" + first, head + "(" + _typo(first.split(".")[0], rng)


def dangling_file(found: list[Spot], rng: random.Random) -> Iterator[Candidate]:
    """A file that is not there, or leaves the project."""
    for s in scalars(found):
        if s.path and s.path[-1] in FILES and isinstance(s.node.value, str):
            yield (
                s,
                s.node.plain,
                rng.choice(["absent." + s.node.plain.split("/")[-1], "../../../../../../etc/passwd", "/etc/passwd"]),
            )


def bad_call(found: list[Spot], rng: random.Random) -> Iterator[Candidate]:
    """A predicate that there is not, with too many arguments, or without its parenthesis."""
    for s in scalars(found):
        if CALL.fullmatch(s.node.plain):
            head = s.node.plain.partition("(")[0]
            yield (
                s,
                head + "(",
                rng.choice([f"{head}x(", f"{head.lower()}_(", f"{head}(a_b, c_d, e_f, g_h, ", f"{head} "]),
            )


def misspelled_key(found: list[Spot], rng: random.Random) -> Iterator[Candidate]:
    """A key with a letter too many, in another case, or of another unit."""
    named = (
        "objects",
        "materials",
        "cameras",
        "lights",
        "robots",
        "links",
        "joints",
        "parts",
        "frames",
        "subtasks",
        "names",
        "parameters",
        "include",
        "templates",
    )
    free = ("start", "reset", "allow", "conflicts", "pose", "place")
    for s in found:
        if s.key is None or not isinstance(s.path[-1], str):
            continue
        parent = s.path[-2] if len(s.path) > 1 else ""
        if parent in named or (len(s.path) > 2 and s.path[-3] in free and s.path[0] in free):
            continue
        if s.path[0] in ("start", "subtasks", "scene", "object") and parent in ("objects", "joints", "place", "pose"):
            continue
        key = s.path[-1]
        units = {
            "yaw_deg": "yaw",
            "rpy_deg": "rpy",
            "limits_deg": "limits_rad",
            "quat_wxyz": "quat_xyzw",
            "mass": "mass_g",
            "xyz": "xyz_mm",
        }
        yield (
            Spot(s.path, Node(None, *s.key), s.key),
            key,
            rng.choice([_typo(key, rng), key.upper(), units.get(key, key + "_mm")]),
        )


def with_unit(found: list[Spot], rng: random.Random) -> Iterator[Candidate]:
    """A number with its unit behind it."""
    for s in numbers(found):
        if "conflicts" not in s.path:
            yield s, s.node.plain, f"{s.node.plain} {rng.choice(['cm', 'kg', 'mm', 'deg', 'g'])}"


SIMPLE: dict[str, Callable[[list[Spot], random.Random], Iterator[Candidate]]] = {
    "type": wrong_type,
    "range": out_of_range,
    "choice": wrong_choice,
    "name": dangling_name,
    "file": dangling_file,
    "predicate": bad_call,
    "key": misspelled_key,
    "unit": with_unit,
}


def _typo(word: str, rng: random.Random) -> str:
    """A slip of the finger that gives a word which nothing has."""
    k = rng.randrange(1, len(word)) if len(word) > 1 else 1
    return rng.choice([word[:k] + "q" + word[k:], word[:k] + "zz", word + "s_q"])


def simple_mutants(text: str, found: list[Spot], rng: random.Random) -> Iterator[Mutant]:
    """One corruption of each kind at each place where it applies."""
    for kind, candidates in SIMPLE.items():
        for spot, old, new in candidates(found, rng):
            changed = at(text, spot.node.line, spot.node.column, old, new)
            if changed is not None and changed != text:
                yield Mutant(kind, changed, spot.node.line, f"{'.'.join(map(str, spot.path))}: {old} -> {new}")


def arity_mutants(text: str, found: list[Spot]) -> Iterator[Mutant]:
    """A list of fixed length with one value too few or too many."""
    lines = text.splitlines()
    for s in found:
        if s.name in ARITY and isinstance(s.node.children, list) and s.path[-1] == s.name and s.name != "color":
            close = lines[s.node.line - 1].find("]", s.node.column)
            inner = lines[s.node.line - 1][s.node.column : close]
            if close > 0 and "[" not in inner and inner.count(",") + 1 == len(s.node.children):
                for new in (inner.rpartition(",")[0], f"{inner}, 1"):
                    changed = at(text, s.node.line, s.node.column + 1, inner, new)
                    if changed is not None:
                        yield Mutant(
                            "arity", changed, s.node.line, f"{'.'.join(map(str, s.path))}: [{inner}] -> [{new}]"
                        )


def duplicate_mutants(text: str, found: list[Spot]) -> Iterator[Mutant]:
    """A line that stands twice."""
    lines = text.splitlines(keepends=True)
    seen: set[int] = set()
    for s in found:
        if s.key is None or s.key[0] in seen or s.node.line != s.key[0]:
            continue
        line = lines[s.key[0] - 1]
        indent = len(line) - len(line.lstrip())
        following = lines[s.key[0]] if s.key[0] < len(lines) else ""
        deeper = len(following) - len(following.lstrip()) > indent and following.strip()
        if s.key[1] - 1 == indent and not deeper and line.strip():
            seen.add(s.key[0])
            twice = [*lines[: s.key[0]], line if line.endswith("\n") else "\n" + line, *lines[s.key[0] :]]
            yield Mutant("duplicate", "".join(twice), s.key[0] + 1, f"line {s.key[0]} twice")


def cycle_mutants(text: str, found: list[Spot], file: str) -> Iterator[Mutant]:
    """Documents, places and joints that lead back to themselves."""
    head = text.index("simfoundry:")
    line = text[:head].count("\n") + 2
    cut = text.index("\n", head) + 1
    if not any(s.path == ("extends",) for s in found):
        yield Mutant("cycle", f"{text[:cut]}extends: {file}\n{text[cut:]}", line, "extends itself")
    for s in found:
        if s.path[:1] == ("objects",) and s.path[2:] == ("place", "on") and s.node.plain:
            changed = at(text, s.node.line, s.node.column, s.node.plain, str(s.path[1]))
            if changed is not None:
                yield Mutant("cycle", changed, s.node.line, f"{s.path[1]} stands on itself")
        if s.path[:1] == ("joints",) and s.path[2:] == ("parent",) and s.node.plain:
            child = next(o.node.plain for o in found if o.path == (*s.path[:2], "child"))
            changed = at(text, s.node.line, s.node.column, s.node.plain, child)
            if changed is not None:
                yield Mutant("cycle", changed, s.node.line, f"{child} carries itself")


def mutants(text: str, file: str, rng: random.Random) -> Iterator[Mutant]:
    """Every corruption of a document."""
    found = [s for s in spots(parse(text).root) if s.path]
    yield from simple_mutants(text, found, rng)
    yield from arity_mutants(text, found)
    yield from duplicate_mutants(text, found)
    yield from cycle_mutants(text, found, file)
