"""Slips of a typist: single wrong words, numbers and lines, each made from the text and the positions of its values."""

from __future__ import annotations

import math
import random
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

from simfoundry.spec.models.predicate import PREDICATES, built_in_predicates
from simfoundry.spec.names.positions import TextIndex
from simfoundry.spec.yaml.text import Document
from tests.conftest import REPOSITORY
from tests.corpora.spec_mutants import ARITY, CALL, CHOICES, FILES, NAMES, Spot, spots

FREE = ("name", "description", "category", "labels", "note", "origin", "allow", "instruction", "source", "capture",
        "prompts", "conflicts", "native")  # fmt: skip
"""Keys below which a text is free."""

NAMED = ("objects", "materials", "links", "joints", "cameras", "robots", "parts", "subtasks")
"""Sections whose keys are names."""

LENGTHS = ("box", "sphere", "radius", "height", "xyz", "xy", "look_at", "size", "local_xy", "offset", "ellipsoid")
REFERENCES = (*NAMES, "mount", "joint", "link", "site", "robots", "goal_object")
WORD = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")


@dataclass(frozen=True)
class Slip:
    """A slip: its kind, the new text, the ranges of it that may be underlined, and what was done."""

    kind: str
    text: str
    places: tuple[tuple[int, int], ...]
    done: str


@dataclass
class Source:
    """A document to slip in, with everything that a slip is made from."""

    text: str
    document: Document
    elsewhere: frozenset[str]
    index: TextIndex = field(init=False)
    found: list[Spot] = field(init=False)
    names: set[str] = field(init=False)

    def __post_init__(self) -> None:
        self.index = TextIndex(self.text)
        self.found = [*spots(self.document.root)]
        self.names = {str(part) for spot in self.found for part in spot.path}

    def start(self, place: tuple[int, int]) -> int:
        return self.index.offset(*place)

    def around(self, spot: Spot) -> list[tuple[int, int]]:
        """The ranges of the key of a value, and of the key right above."""
        keys = []
        for end in (len(spot.path), len(spot.path) - 1, len(spot.path) - 2):
            part = spot.path[end - 1] if end > 0 else None
            if isinstance(part, str):
                start = self.start(self.document.place(spot.path[:end], of_key=True))
                keys.append((start, start + len(part)))
        return keys[:2]

    def slip(self, kind: str, spot: Spot | None, start: int, old: str, new: str, *more: tuple[int, int]) -> Slip | None:
        """Replace ``old`` at an offset; the ranges in ``more`` and of the keys above count as well."""
        if not self.text.startswith(old, start) or old == new:
            return None
        text = self.text[:start] + new + self.text[start + len(old) :]
        moved = len(new) - len(old)
        wider = [*more, *(self.around(spot) if spot is not None else [])]
        places = [(a, b) if b <= start else (a + moved, b + moved) for a, b in wider if b <= start or a > start]
        line = self.text.count("\n", 0, start) + 1
        return Slip(kind, text, ((start, start + max(1, len(new))), *places), f"line {line}: `{old}` to `{new}`")


def is_free(spot: Spot) -> bool:
    return any(part in FREE for part in spot.path)


def mistyped(word: str, rng: random.Random) -> str:
    """The word with a letter swapped, dropped, doubled, or replaced by its neighbor on the keyboard."""
    letters = [k for k, c in enumerate(word) if c.isalpha()]
    if not letters:
        return word
    k = rng.choice(letters)
    match rng.randrange(4):
        case 0 if k + 1 < len(word) and word[k + 1] != word[k]:
            return word[:k] + word[k + 1] + word[k] + word[k + 2 :]
        case 1 if len(word) > 2:
            return word[:k] + word[k + 1 :]
        case 2:
            return word[:k] + word[k] + word[k:]
    rows = ("qwertyuiop", "asdfghjkl", "zxcvbnm")
    row = next(r for r in rows if word[k].lower() in r)
    near = row[row.index(word[k].lower()) - 1 or 1]
    return word[:k] + (near.upper() if word[k].isupper() else near) + word[k + 1 :]


def vocabulary() -> set[str]:
    """Every key of the language, as the generated schemas list them."""
    import json

    found: set[str] = set()
    todo: list[Any] = [json.loads(p.read_text()) for p in (REPOSITORY / "schemas").glob("*.schema.json")]
    while todo:
        data = todo.pop()
        if isinstance(data, dict):
            found |= set(data.get("properties", ()))
            todo += data.values()
        elif isinstance(data, list):
            todo += data
    return found


Maker = Callable[[Source, random.Random], Iterator[Slip | None]]
KEYS = vocabulary()


def keys(s: Source, rng: random.Random) -> Iterator[Slip | None]:
    for spot in s.found:
        key = spot.path[-1] if spot.path else 0
        if isinstance(key, str) and spot.key and key in KEYS and not is_free(Spot(spot.path[:-1], spot.node, None)):
            above = [p for p in spot.path[:-1] if isinstance(p, str)]
            if above and above[-1] in (
                "objects",
                "materials",
                "links",
                "joints",
                "cameras",
                "robots",
                "parts",
                "subtasks",
            ):
                continue  # a name that is also a word of the language
            new = mistyped(key, rng)
            if new not in KEYS:
                yield s.slip("key", None, s.start(spot.key), key, new)


def _named(s: Source) -> Iterator[tuple[Spot, int, str]]:
    """Each name in a reference or predicate, with its offset."""
    for spot in s.found:
        if spot.node.children is not None or not isinstance(spot.node.value, str) or is_free(spot):
            continue
        start = s.start(spot.node.place)
        raw = s.text[start : s.text.find("\n", start)]
        call = CALL.match(raw.lstrip("\"'"))
        if call is not None:
            start += len(raw) - len(raw.lstrip("\"'"))
            inside = call[0].index("(")
            for word in re.finditer(r"[a-z][a-z0-9_]*", call[0][inside:]):
                yield spot, start + inside + word.start(), word[0]
        elif spot.name in REFERENCES and spot.node.plain == spot.node.value:
            for word in re.finditer(r"[a-z][a-z0-9_]*", spot.node.plain):
                if "/" not in spot.node.plain:
                    yield spot, start + word.start(), word[0]


def names(s: Source, rng: random.Random) -> Iterator[Slip | None]:
    for _, start, word in _named(s):
        new = mistyped(word, rng)
        if new not in s.names and len(new) > 1:
            yield s.slip("name", None, start, word, new)


def foreign_names(s: Source, rng: random.Random) -> Iterator[Slip | None]:
    others = sorted(s.elsewhere - s.names)
    for _, start, word in _named(s):
        if others:
            yield s.slip("name of another document", None, start, word, rng.choice(others))


def predicates(s: Source, rng: random.Random) -> Iterator[Slip | None]:
    known = {*built_in_predicates(), *PREDICATES.names()}
    known |= {alias for p in built_in_predicates().values() for alias in p.aliases}
    for found in CALL.finditer(s.text):
        if "#" in s.text[s.text.rfind("\n", 0, found.start()) : found.start()]:
            continue
        name = found[0].partition("(")[0]
        new = mistyped(name, rng)
        if new not in known and name in known:
            yield s.slip("predicate", None, found.start(), name, new, (found.start(), found.end()))


def arity(s: Source, rng: random.Random) -> Iterator[Slip | None]:
    every = built_in_predicates()
    for found in CALL.finditer(s.text):
        if "#" in s.text[s.text.rfind("\n", 0, found.start()) : found.start()]:
            continue
        name, _, inside = found[0].removesuffix(")").partition("(")
        if name in every and not every[name].optional:
            given = inside.split(",")
            new = given[:-1] if rng.random() < 0.5 else [*given, f" {given[0].strip()}"]
            yield s.slip("argument", None, found.start(), found[0], f"{name}({','.join(new)})")
    for spot in s.found:
        if spot.name in ARITY and isinstance(spot.node.children, list) and len(spot.node.children) > 1:
            if spot.name == "color" or is_free(spot) or not isinstance(spot.path[-1], str):
                continue
            raw = _flow(s, spot)
            if raw and "[" not in raw[1:]:
                cut = raw[: raw.rindex(",")] + "]" if rng.random() < 0.5 else f"{raw[:-1]}, 0.1]"
                if spot.name not in ("scale",):
                    yield s.slip("list", spot, s.start(spot.node.place), raw, cut)


def _flow(s: Source, spot: Spot) -> str:
    """A list of numbers in brackets as it is written, or nothing if it is written otherwise."""
    found = re.compile(r"\[[^\[\]\n]*\]").match(s.text, s.start(spot.node.place))
    return found[0] if found is not None else ""


def _numbers(s: Source) -> Iterator[Spot]:
    for spot in s.found:
        value = spot.node.value
        if isinstance(value, int | float) and not isinstance(value, bool) and spot.node.plain and not is_free(spot):
            yield spot


def files(s: Source, rng: random.Random) -> Iterator[Slip | None]:
    for spot in s.found:
        plain = spot.node.plain
        if spot.name in FILES and "." in plain and ":" not in plain:
            stem = plain.rpartition("/")[2].partition(".")[0]
            start = s.start(spot.node.place) + len(plain) - len(plain.rpartition("/")[2])
            yield s.slip("file", None, start, stem, mistyped(stem, rng))


def choices(s: Source, rng: random.Random) -> Iterator[Slip | None]:
    for spot in s.found:
        if spot.name in CHOICES and spot.node.plain and isinstance(spot.node.value, str) and not is_free(spot):
            word = WORD.match(spot.node.plain)
            if word is not None:
                yield s.slip("choice", None, s.start(spot.node.place), word[0], mistyped(word[0], rng))


def quoted_numbers(s: Source, _: random.Random) -> Iterator[Slip | None]:
    for spot in _numbers(s):
        yield s.slip("quoted number", None, s.start(spot.node.place), spot.node.plain, f'"{spot.node.plain}"')


def suffixes(s: Source, rng: random.Random) -> Iterator[Slip | None]:
    for spot in _numbers(s):
        unit = "kg" if spot.name == "mass" else "deg" if spot.name.endswith("deg") else "m"
        new = f"{spot.node.plain}{rng.choice(['', ' '])}{unit}"
        yield s.slip("unit suffix", None, s.start(spot.node.place), spot.node.plain, new)


def _scaled(text: str, factor: float) -> str:
    return f"{float(text) * factor:g}"


def millimeters(s: Source, _: random.Random) -> Iterator[Slip | None]:
    for spot in s.found:
        if spot.name not in LENGTHS or is_free(spot) or not isinstance(spot.path[-1], str) or spot.path[0] == "lights":
            continue
        if s.document.data.get("simfoundry") not in ("scene/1", "asset/1", "task/1") or spot.path[0] == "reset":
            continue
        if spot.name == "size" and "open_box" not in spot.path:
            continue  # pixels
        nodes = [*spot.node.members] or [spot.node]
        if not all(isinstance(n.value, int | float) and n.plain for n in nodes):
            continue
        if max(abs(n.value) for n in nodes) < 1e-3:
            continue
        raw = _flow(s, spot) if spot.node.children is not None else spot.node.plain
        if raw:
            new = re.sub(r"-?[0-9.]+(?:e-?[0-9]+)?", lambda m: _scaled(m[0], 1000), raw)
            yield s.slip("mm for m", spot, s.start(spot.node.place), raw, new)


def grams(s: Source, _: random.Random) -> Iterator[Slip | None]:
    for spot in _numbers(s):
        if spot.path[-1] == "mass":
            new = _scaled(spot.node.plain, 1000)
            yield s.slip("g for kg", spot, s.start(spot.node.place), spot.node.plain, new)


def radians(s: Source, _: random.Random) -> Iterator[Slip | None]:
    for spot in _numbers(s):
        if spot.name.endswith("deg") and abs(spot.node.value) >= 10:
            new = f"{math.radians(spot.node.value):.4f}"
            yield s.slip("radians for degrees", spot, s.start(spot.node.place), spot.node.plain, new)


def removed(s: Source, _: random.Random) -> Iterator[Slip | None]:
    """Remove an object or a material on one line that is used in the same document; a use of it must be underlined."""
    for spot in s.found:
        if len(spot.path) != 2 or spot.path[0] not in ("objects", "materials", "links", "templates") or not spot.key:
            continue
        name = str(spot.path[1])
        first = s.start((spot.key[0], 1))
        lines = s.text[first:].splitlines(keepends=True)
        indent = spot.key[1] - 1
        stop = next(
            (k for k, line in enumerate(lines[1:], 1) if line.strip() and len(line) - len(line.lstrip()) <= indent),
            len(lines),
        )
        entry = "".join(lines[:stop])
        uses = [(start, start + len(word)) for _, start, word in _named(s) if word == name]
        uses = [(a, b) for a, b in uses if not first <= a < first + len(entry)]
        if uses and s.text[:first].endswith("\n") and s.text[first:].startswith(" " * indent + name):
            made = s.slip("removed", None, first, entry, "", *uses)
            if made is not None:
                yield Slip(made.kind, made.text, made.places[1:], f"removed `{name}`")


def joints(s: Source, rng: random.Random) -> Iterator[Slip | None]:
    for spot in s.found:
        is_scene = s.document.data.get("simfoundry") == "scene/1"
        if is_scene and spot.path[-2:-1] == ("joints",) and spot.key:
            key = str(spot.path[-1])
            yield s.slip("joint", None, s.start(spot.key), key, mistyped(key, rng))


def syntax(s: Source, rng: random.Random) -> Iterator[Slip | None]:
    """Slips of layout; their line, or the next one, counts."""
    start = 0
    for line in s.text.splitlines(keepends=True):
        body = line.split(" #")[0].rstrip("\n")
        end = start + len(line)
        following = s.text.find("\n", end)
        both = (start, following if following >= 0 else len(s.text))
        made: list[tuple[str, str]] = []
        key = re.match(r"( *)([a-z_][a-z0-9_]*):( |$)", body)
        if key is not None and not any(f"{word}:" in body for word in FREE):
            made.append(("missing colon", body.replace(":", "", 1)))
            if key[1]:
                made.append(("tab", "\t" + body.lstrip()))
                made.append(("indentation", body[1:] if rng.random() < 0.5 else " " + body))
        if "]" in body or "}" in body:
            k = max(body.rfind("]"), body.rfind("}"))
            made.append(("unclosed bracket", body[:k] + body[k + 1 :]))
            both = (min(start, opening(s.text, start + k)), both[1])
        if body.count('"') == 2:
            k = body.rfind('"')
            made.append(("unclosed quote", body[:k] + body[k + 1 :]))
        for kind, new in made:
            if not line.lstrip().startswith("#"):
                text = s.text[:start] + new + line[len(body) :] + s.text[end:]
                yield Slip(kind, text, (both,), f"line {s.text.count(chr(10), 0, start) + 1}: `{body.strip()[:50]}`")
        start = end


def opening(text: str, closing: int) -> int:
    """The offset of the bracket that a bracket closes; no text of the specs contains others."""
    depth = 0
    for k in range(closing, -1, -1):
        depth += (text[k] in "]}") - (text[k] in "[{")
        if not depth:
            return k
    return closing


MAKERS: tuple[Maker, ...] = (keys, names, foreign_names, predicates, arity, files, choices, quoted_numbers, suffixes,
                             millimeters, grams, radians, removed, joints, syntax)  # fmt: skip
