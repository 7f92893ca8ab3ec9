"""Read BDDL files: parse the PDDL expressions, and extract the problem that they define."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from simfoundry.frontends.errors import ImportRefusedError


@dataclass(frozen=True)
class BddlRegion:
    """Part of an object, or a rectangle on it.

    ``ranges`` are (min x, min y, max x, max y) [m] in the frame of ``target``; ``yaw`` is the minimum and maximum
    rotation about z [rad]. Both are None if the file does not specify them.
    """

    name: str
    target: str
    ranges: tuple[float, float, float, float] | None
    yaw: tuple[float, float] | None


@dataclass(frozen=True)
class BddlProblem:
    """BDDL problem; ``kinds`` maps objects and fixtures to types, and ``regions`` has regions by qualified name.

    ``domain`` is ``robosuite`` for LIBERO and ``omnigibson`` (``igibson`` in older files) for BEHAVIOR.
    """

    file: Path
    name: str
    domain: str
    language: str
    kinds: Mapping[str, str]
    regions: Mapping[str, BddlRegion]
    interest: tuple[str, ...]
    init: tuple[BddlGroup, ...]
    goal: BddlGroup


def read_problem(path: Path) -> BddlProblem:
    """Read a BDDL file; raises :class:`ImportRefusedError`."""
    whole = read_group(path)
    if whole.head != "define":
        raise ImportRefusedError(path, "it does not begin with `(define`", whole.line)
    sections: dict[str, BddlGroup] = {}
    for group in whole.groups:
        if group.head in sections:
            raise ImportRefusedError(path, f"`{group.head}` stands here again", group.line)
        sections[group.head] = group
    for needed in ("problem", ":goal"):
        if needed not in sections:
            raise ImportRefusedError(path, f"it has no `({needed} …)`", whole.line)
    goal = sections[":goal"]
    if len(goal.groups) != 1:
        raise ImportRefusedError(path, "its goal is not one condition", goal.line)
    kinds: dict[str, str] = {}
    for key in (":fixtures", ":objects"):
        if key in sections:
            _read_things(path, sections[key], kinds)
    return BddlProblem(
        file=path,
        name=_text(sections["problem"]) or path.stem,
        domain=_text(sections.get(":domain")).lower(),
        language=_text(sections.get(":language")),
        kinds=kinds,
        regions=_regions(path, sections.get(":regions")),
        interest=tuple(w.text for w in sections[":obj_of_interest"].words) if ":obj_of_interest" in sections else (),
        init=sections[":init"].groups if ":init" in sections else (),
        goal=goal.groups[0],
    )


def _text(group: BddlGroup | None) -> str:
    return " ".join(word.text for word in group.words) if group is not None else ""


def _read_things(path: Path, group: BddlGroup, kinds: dict[str, str]) -> None:
    """Read a typed PDDL list, such as ``a b - kind c - other``, into ``kinds``."""
    waiting: list[BddlWord] = []
    words = list(group.words)
    while words:
        word = words.pop(0)
        if word.text != "-":
            waiting.append(word)
            continue
        if not words or not waiting:
            raise ImportRefusedError(path, "`-` stands between names and their type", word.line)
        kind = words.pop(0).text
        for name in waiting:
            if name.text in kinds:
                raise ImportRefusedError(path, f"`{name.text}` is there twice", name.line)
            kinds[name.text] = kind
        waiting = []
    for name in waiting:
        kinds.setdefault(name.text, name.text)


def _regions(path: Path, group: BddlGroup | None) -> dict[str, BddlRegion]:
    """Return the regions by ``TARGET_NAME``, the name that conditions use."""
    found: dict[str, BddlRegion] = {}
    for region in group.groups if group is not None else ():
        parts = {part.head: part for part in region.groups}
        if ":target" not in parts or not parts[":target"].words:
            raise ImportRefusedError(path, f"region `{region.head}` has no target", region.line)
        target = parts[":target"].words[0].text
        ranges = _numbers(path, parts.get(":ranges"), 4)
        yaw = _numbers(path, parts.get(":yaw_rotation"), 2)
        name = region.items[0].text if isinstance(region.items[0], BddlWord) else region.head
        box = (ranges[0], ranges[1], ranges[2], ranges[3]) if ranges else None
        found[f"{target}_{name}"] = BddlRegion(name, target, box, (yaw[0], yaw[1]) if yaw else None)
    return found


def _numbers(path: Path, group: BddlGroup | None, count: int) -> list[float] | None:
    """Return the numbers of ``(:key ((1 2 3 4)))``, or those of the first rectangle if there are several."""
    while group is not None and group.groups:
        group = group.groups[0]
    if group is None:
        return None
    try:
        numbers = [float(item.text) for item in group.items if isinstance(item, BddlWord)]
    except ValueError:
        numbers = []
    if len(numbers) != count or not all(map(math.isfinite, numbers)):
        raise ImportRefusedError(path, f"{count} numbers are expected here", group.line)
    return numbers


MAX_BYTES = 4 * 2**20
"""Largest file size [bytes]; the largest problem of BEHAVIOR-1K has 20 kB."""

MAX_DEPTH = 64
"""Largest nesting depth; actual problems have about a tenth of it."""

_TOKEN = re.compile(r"[()]|[^\s();]+|;[^\n]*|\n")


@dataclass(frozen=True)
class BddlWord:
    """A word and its line number; BDDL keywords are case-insensitive."""

    text: str
    line: int

    @property
    def plain(self) -> str:
        """Return the word in lower case, without the prefix of a variable."""
        return self.text.lower().removeprefix("?")


@dataclass(frozen=True)
class BddlGroup:
    """A bracketed expression."""

    items: tuple[BddlWord | BddlGroup, ...]
    line: int

    @property
    def head(self) -> str:
        """Return the first word in lower case; empty if the group is empty or begins with a bracket."""
        return self.items[0].plain if self.items and isinstance(self.items[0], BddlWord) else ""

    @property
    def rest(self) -> tuple[BddlWord | BddlGroup, ...]:
        """Return all elements except the first."""
        return self.items[1:]

    @property
    def groups(self) -> tuple[BddlGroup, ...]:
        """Return the nested groups."""
        return tuple(item for item in self.items if isinstance(item, BddlGroup))

    @property
    def words(self) -> tuple[BddlWord, ...]:
        """Return the words except the first."""
        return tuple(item for item in self.rest if isinstance(item, BddlWord))


def read_group(path: Path) -> BddlGroup:
    """Return the single expression of a file; raises :class:`ImportRefusedError`."""
    if path.stat().st_size > MAX_BYTES:
        raise ImportRefusedError(path, f"it is larger than {MAX_BYTES >> 20} MiB, which no task is")
    try:
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        raise ImportRefusedError(path, "it is not UTF-8 text") from None
    open_groups: list[tuple[list[BddlWord | BddlGroup], int]] = []
    whole: BddlGroup | None = None
    for token, line in _tokens(text):
        if token == "(":
            open_groups.append(([], line))
            if len(open_groups) > MAX_DEPTH:
                raise ImportRefusedError(path, f"brackets are nested deeper than {MAX_DEPTH}", line)
        elif not open_groups and token == ")":
            raise ImportRefusedError(path, "this bracket closes nothing", line)
        elif whole is not None or not open_groups:
            raise ImportRefusedError(path, f"`{token[:40]}` stands outside the problem", line)
        elif token != ")":
            open_groups[-1][0].append(BddlWord(token, line))
        else:
            items, start = open_groups.pop()
            group = BddlGroup(tuple(items), start)
            if open_groups:
                open_groups[-1][0].append(group)
            else:
                whole = group
    if open_groups:
        raise ImportRefusedError(path, "this bracket is never closed", open_groups[-1][1])
    if whole is None:
        raise ImportRefusedError(path, "it is empty", hint="a problem begins with `(define (problem NAME)`")
    return whole


def _tokens(text: str) -> Iterator[tuple[str, int]]:
    line = 1
    for match in _TOKEN.finditer(text):
        token = match[0]
        if token == "\n":
            line += 1
        elif token[0] != ";":
            yield token, line
