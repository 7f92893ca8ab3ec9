"""Changes in one place of a document that often leave it valid: extreme numbers, other names, words and predicates."""

from __future__ import annotations

import random
import re
from collections.abc import Iterator

from simfoundry.spec.yaml.text import parse
from tests.corpora.spec_mutants import CALL, NAMES, Candidate, Mutant, Spot, at, numbers, scalars, spots

NUMBERS = ("0", "1e-9", "1e-15", "1e-300", "1e6", "1e9", "1e15", "1e30", "1e300", "1000000")
WORDS = {
    "type": ("fixed", "revolute", "prismatic", "continuous", "ball", "free", "distant", "point", "dome"),
    "collision": ("none", "hull", "auto"),
    "use": ("visual", "collision", "both"),
    "closed": ("lower", "upper"),
}
"""Values that are valid somewhere, by key."""

MEMBERS = (
    "collision: none",
    "fixed: true",
    "use: visual",
    "scale: 1000",
    "mass: 1e-12",
    "friction: 100",
    "solid: hull",
)
"""Members that are valid in some mappings."""

PREDICATES = (
    "OnTop",
    "Inside",
    "Under",
    "Touching",
    "Open",
    "Closed",
    "Upright",
    "Lifted",
    "Grasped",
    "Released",
    "At",
)


def odd_mutants(text: str, rng: random.Random) -> Iterator[Mutant]:
    """Every change of a document: what passes the check must work everywhere else."""
    found = [s for s in spots(parse(text).root) if s.path]
    for kind, (spot, old, new) in [
        *(("number", c) for c in _other_numbers(found, rng)),
        *(("word", c) for c in _other_words(found)),
        *(("name", c) for c in _other_names(found, rng)),
        *(("predicate", c) for c in _other_predicates(found, rng)),
        *(("member", c) for c in _more_members(found, rng)),
    ]:
        changed = at(text, spot.node.line, spot.node.column, old, new)
        if changed is not None and changed != text:
            yield Mutant(kind, changed, spot.node.line, f"{'.'.join(map(str, spot.path))}: {old} -> {new}")
    yield from _fewer_lines(text, found)


def _other_numbers(found: list[Spot], rng: random.Random) -> Iterator[Candidate]:
    for s in numbers(found):
        yield s, s.node.plain, rng.choice([*NUMBERS, f"-{s.node.plain}", f"{s.node.plain}e3"])


def _other_words(found: list[Spot]) -> Iterator[Candidate]:
    for s in scalars(found):
        for word in WORDS.get(str(s.path[-1]), ()):
            yield s, s.node.plain, word
        if isinstance(s.node.value, bool):
            yield s, s.node.plain, str(not s.node.value).lower()


def _known(found: list[Spot], rng: random.Random) -> list[str]:
    """Names of objects, robots and links, and names with a part, some of which exist."""
    names = sorted({str(s.path[-1]) for s in found if s.key and re.fullmatch("[a-z][a-z0-9_]*", str(s.path[-1]))})
    owners = sorted({str(s.path[1]) for s in found if len(s.path) == 2 and s.path[0] in ("objects", "robots", "links")})
    written = {
        word for s in scalars(found) for word in re.findall(r"[a-z][a-z0-9_]*(?:\.[a-z0-9_]+)?", str(s.node.value))
    }
    parts = [f"{owner}.{name}" for owner in owners for name in rng.sample(names, min(6, len(names)))]
    return [*owners, *parts, *sorted(written)]


def _other_names(found: list[Spot], rng: random.Random) -> Iterator[Candidate]:
    known = _known(found, rng)
    for s in scalars(found):
        if s.path[-1] in (*NAMES, "mount", "variant", "joint") or "no_contact" in s.path:
            for other in rng.sample(known, min(6, len(known))):
                yield s, s.node.plain, other


def _other_predicates(found: list[Spot], rng: random.Random) -> Iterator[Candidate]:
    known = _known(found, rng)
    for s in found:
        call = CALL.fullmatch(s.node.value) if isinstance(s.node.value, str) else None
        for _ in range(6 if call is not None and len(known) > 1 else 0):
            new = f"{rng.choice(PREDICATES)}({', '.join(rng.sample(known, rng.choice([1, 2])))})"
            yield (s, s.node.plain, new) if s.node.plain else (s, f'"{s.node.value}"', f'"{new}"')


def _more_members(found: list[Spot], rng: random.Random) -> Iterator[Candidate]:
    for s in found:
        if s.key is not None and isinstance(s.node.children, dict):
            for more in rng.sample(MEMBERS, 2):
                yield s, "{", f"{{{more}, "


def _fewer_lines(text: str, found: list[Spot]) -> Iterator[Mutant]:
    """A line less: what it said is then said by a default, or missing."""
    lines = text.splitlines(keepends=True)
    starts = [s.key[0] for s in found if s.key is not None]
    for s in found:
        if s.key is not None and starts.count(s.key[0]) == 1:
            left = [*lines[: s.key[0] - 1], *lines[s.key[0] :]]
            yield Mutant("less", "".join(left), s.key[0], f"without {'.'.join(map(str, s.path))}")
