"""A BDDL problem as it stands in its file: objects, regions, how it starts, its goal."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from simfoundry.frontends.bddl.expressions import BddlGroup, BddlWord, read_group
from simfoundry.frontends.errors import ImportRefusedError


@dataclass(frozen=True)
class BddlRegion:
    """A part of a thing, or a rectangle on it.

    ``ranges`` are (lowest x, lowest y, highest x, highest y) in the frame of ``target`` [m]; ``yaw`` is the lowest and
    the highest turn about z [rad]; both are None where the file gives none.
    """

    name: str
    target: str
    ranges: tuple[float, float, float, float] | None
    yaw: tuple[float, float] | None


@dataclass(frozen=True)
class BddlProblem:
    """A problem: ``things`` are the types of all objects and fixtures by their names, ``regions`` by their long names.

    ``domain`` is ``robosuite`` for LIBERO and ``omnigibson`` (``igibson`` in older files) for BEHAVIOR.
    """

    file: Path
    name: str
    domain: str
    language: str
    things: Mapping[str, str]
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
    things: dict[str, str] = {}
    for key in (":fixtures", ":objects"):
        if key in sections:
            _read_things(path, sections[key], things)
    return BddlProblem(
        file=path,
        name=_text(sections["problem"]) or path.stem,
        domain=_text(sections.get(":domain")).lower(),
        language=_text(sections.get(":language")),
        things=things,
        regions=_regions(path, sections.get(":regions")),
        interest=tuple(w.text for w in sections[":obj_of_interest"].words) if ":obj_of_interest" in sections else (),
        init=sections[":init"].groups if ":init" in sections else (),
        goal=goal.groups[0],
    )


def _text(group: BddlGroup | None) -> str:
    return " ".join(word.text for word in group.words) if group is not None else ""


def _read_things(path: Path, group: BddlGroup, things: dict[str, str]) -> None:
    """``a b - kind c - other``, as PDDL writes typed lists."""
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
            if name.text in things:
                raise ImportRefusedError(path, f"`{name.text}` is there twice", name.line)
            things[name.text] = kind
        waiting = []
    for name in waiting:
        things.setdefault(name.text, name.text)


def _regions(path: Path, group: BddlGroup | None) -> dict[str, BddlRegion]:
    """By ``TARGET_NAME``, as the conditions call them."""
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
    """The numbers of ``(:key ((1 2 3 4)))``: of the first rectangle where there are more."""
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
