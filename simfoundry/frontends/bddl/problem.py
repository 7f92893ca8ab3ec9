"""Read BDDL files: parse the PDDL expressions, extract the problem, and convert its conditions to predicates.

Quantifiers are expanded over the scene's objects to `all`, `any` and `not`, with the same semantics as in the `bddl`
package. `forn` requires exactly n objects, and `fornpairs` requires exactly n pairs. `forpairs` refers to two groups of
objects, the smaller of which has k members; it requires that at least k objects in each group have a partner.
"""

from __future__ import annotations

import math
import re
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations, product
from math import comb
from pathlib import Path
from typing import Any

from simfoundry.frontends.errors import ImportRefusedError


@dataclass(frozen=True)
class BddlRegion:
    """A region in a BDDL problem: either a part of an object or a rectangle on it.

    ``ranges`` is the rectangle (min x, min y, max x, max y) [m] in the frame of ``target``, and ``yaw`` is the minimum
    and maximum rotation about z [rad]. Either is None if the file does not specify it.
    """

    name: str
    target: str
    ranges: tuple[float, float, float, float] | None
    yaw: tuple[float, float] | None


@dataclass(frozen=True)
class BddlProblem:
    """A BDDL problem.

    ``kinds`` maps the names of objects and fixtures to their types, and ``regions`` maps qualified names to regions.
    ``domain`` is ``robosuite`` for LIBERO, and ``omnigibson`` (or ``igibson`` in older files) for BEHAVIOR.
    """

    name: str
    domain: str
    language: str
    kinds: Mapping[str, str]
    regions: Mapping[str, BddlRegion]
    init: tuple[BddlGroup, ...]
    goal: BddlGroup


def read_problem(path: Path) -> BddlProblem:
    """Read a BDDL file.

    Raises:
        ImportRefusedError: If the file is invalid.
    """
    whole = read_group(path)
    if whole.head != "define":
        raise ImportRefusedError(path, "the file must begin with `(define`", whole.line)
    sections: defaultdict[str, BddlGroup] = defaultdict(lambda: BddlGroup((), whole.line))
    for group in whole.groups:
        if group.head in sections:
            raise ImportRefusedError(path, f"there is more than one `{group.head}` section", group.line)
        sections[group.head] = group
    for needed in ("problem", ":goal"):
        if needed not in sections:
            raise ImportRefusedError(path, f"the problem has no `({needed} …)` section", whole.line)
    goal = sections[":goal"]
    if len(goal.groups) != 1:
        raise ImportRefusedError(path, "the goal must be a single condition", goal.line)
    kinds: dict[str, str] = {}
    for key in (":fixtures", ":objects"):
        _read_things(path, sections[key], kinds)
    return BddlProblem(
        name=sections["problem"].text or path.stem,
        domain=sections[":domain"].text.lower(),
        language=sections[":language"].text,
        kinds=kinds,
        regions=_regions(path, sections[":regions"]),
        init=sections[":init"].groups,
        goal=goal.groups[0],
    )


def _read_things(path: Path, group: BddlGroup, kinds: dict[str, str]) -> None:
    """Read a typed PDDL list, such as ``a b - kind c - other``, into ``kinds``."""
    waiting: list[BddlWord] = []
    words = iter(group.words)
    for word in words:
        if word.text != "-":
            waiting.append(word)
            continue
        kind = next(words, None)
        if kind is None or not waiting:
            raise ImportRefusedError(path, "`-` must be placed between names and their type", word.line)
        for name in waiting:
            if name.text in kinds:
                raise ImportRefusedError(path, f"`{name.text}` is listed twice", name.line)
            kinds[name.text] = kind.text
        waiting = []
    for name in waiting:
        kinds.setdefault(name.text, name.text)


def _regions(path: Path, group: BddlGroup) -> dict[str, BddlRegion]:
    """Return the regions, keyed by the names that conditions use (``TARGET_NAME``)."""
    found: dict[str, BddlRegion] = {}
    for region in group.groups:
        parts = {part.head: part for part in region.groups}
        if ":target" not in parts or not parts[":target"].words:
            raise ImportRefusedError(path, f"region `{region.head}` has no target", region.line)
        target = parts[":target"].words[0].text
        ranges, yaw = _numbers(path, parts.get(":ranges"), 4), _numbers(path, parts.get(":yaw_rotation"), 2)
        name = region.items[0].text if isinstance(region.items[0], BddlWord) else region.head
        found[f"{target}_{name}"] = BddlRegion(name, target, ranges, yaw)
    return found


def _numbers(path: Path, group: BddlGroup | None, count: int) -> Any:
    """Return the numbers in ``(:key ((1 2 3 4)))``, using only the first rectangle if there are several."""
    while group is not None and group.groups:
        group = group.groups[0]
    if group is None:
        return None
    try:
        numbers = tuple(float(item.text) for item in group.items if isinstance(item, BddlWord))
    except ValueError:
        numbers = ()
    if len(numbers) != count or not all(map(math.isfinite, numbers)):
        raise ImportRefusedError(path, f"expected {count} numbers here", group.line)
    return numbers


# Maximum file size [bytes]; the largest problem in BEHAVIOR-1K has 20 kB.
MAX_BYTES = 4 * 2**20

# Maximum nesting depth; real problems use about a tenth of it.
MAX_DEPTH = 64

_TOKEN = re.compile(r"[()]|[^\s();]+|;[^\n]*|\n")


@dataclass(frozen=True)
class BddlWord:
    """A word and its line number. BDDL keywords are case-insensitive."""

    text: str
    line: int

    @property
    def plain(self) -> str:
        """Return the word in lower case, without the `?` prefix that marks a variable."""
        return self.text.lower().removeprefix("?")


@dataclass(frozen=True)
class BddlGroup:
    """A parenthesized expression."""

    items: tuple[BddlWord | BddlGroup, ...]
    line: int

    @property
    def head(self) -> str:
        """Return the first word in lower case, or an empty string if the group does not begin with a word."""
        return self.items[0].plain if self.items and isinstance(self.items[0], BddlWord) else ""

    @property
    def groups(self) -> tuple[BddlGroup, ...]:
        """Return the nested groups."""
        return tuple(item for item in self.items if isinstance(item, BddlGroup))

    @property
    def words(self) -> tuple[BddlWord, ...]:
        """Return all words except the first."""
        return tuple(item for item in self.items[1:] if isinstance(item, BddlWord))

    @property
    def text(self) -> str:
        """Return all words except the first, separated by spaces."""
        return " ".join(word.text for word in self.words)


def read_group(path: Path) -> BddlGroup:
    """Parse a file that contains a single expression.

    Raises:
        ImportRefusedError: If the file is invalid.
    """
    if path.stat().st_size > MAX_BYTES:
        raise ImportRefusedError(path, f"the file is larger than the limit of {MAX_BYTES >> 20} MiB")
    try:
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        raise ImportRefusedError(path, "the file is not valid UTF-8") from None
    open_groups: list[tuple[list[BddlWord | BddlGroup], int]] = []
    whole: BddlGroup | None = None
    line = 1
    for token in _TOKEN.findall(text):
        if token[0] in "\n;":
            line += token == "\n"
        elif token == "(":
            open_groups.append(([], line))
            if len(open_groups) > MAX_DEPTH:
                raise ImportRefusedError(path, f"parentheses are nested more than {MAX_DEPTH} levels deep", line)
        elif not open_groups and token == ")":
            raise ImportRefusedError(path, "unmatched closing parenthesis", line)
        elif whole is not None or not open_groups:
            raise ImportRefusedError(path, f"unexpected `{token[:40]}` outside the problem", line)
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
        raise ImportRefusedError(path, "this parenthesis is never closed", open_groups[-1][1])
    if whole is None:
        raise ImportRefusedError(path, "the file is empty", hint="a problem begins with `(define (problem NAME)`")
    return whole


# Maximum number of predicates in an expanded goal, because quantifiers over many objects grow combinatorially.
MOST_TERMS = 20_000

# A condition as in a document: a predicate, or a mapping with the key `all`, `any` or `not`.
Condition = Any

# The objects bound to variables, by variable name.
Scope = Mapping[str, str]


class Missing(list[str]):
    """A list of the problems that prevent a conversion, without duplicates."""

    def add(self, group: BddlGroup, what: str) -> None:
        """Record a problem at the line of ``group``, unless the same problem has already been recorded."""
        text = f"line {group.line}: {what}"
        if text not in self:
            self.append(text)


@dataclass
class ConditionReader:
    """A converter from BDDL conditions to document conditions.

    ``atom`` creates a predicate from its name and arguments, and ``objects`` lists the objects of each type.
    """

    atom: Callable[[BddlGroup, str, list[str]], Condition | None]
    objects: Mapping[str, Sequence[str]]
    missing: Missing = field(default_factory=Missing)
    terms: int = 0

    def condition(self, group: BddlGroup, scope: Scope) -> Condition | None:
        """Convert a condition.

        If part of the condition cannot be resolved, the problems are added to ``missing`` and None is returned.
        """
        match group.head:
            case "and" | "or":
                key = "all" if group.head == "and" else "any"
                return self._joined(key, [self.condition(g, scope) for g in group.groups])
            case "not" if len(group.groups) == 1:
                return negated(self.condition(group.groups[0], scope))
            case "imply" if len(group.groups) == 2:
                first, second = (self.condition(g, scope) for g in group.groups)
                return self._joined("any", [negated(first), second])
            case "forall" | "exists" | "forn" | "forpairs" | "fornpairs":
                return self._quantified(group, scope)
        self.terms += 1
        words = [scope.get(word.plain, word.text.removeprefix("?")) for word in group.words]
        return self.atom(group, group.head, words)

    def _quantified(self, group: BddlGroup, scope: Scope) -> Condition | None:
        numbered = group.head in ("forn", "fornpairs")
        pairs = group.head in ("forpairs", "fornpairs")
        parts = list(group.groups)
        number = parts.pop(0).head if numbered and parts else "0"
        if len(parts) != (3 if pairs else 2) or not number.isdigit() or len(number) > 5:
            self.missing.add(group, f"`{group.head}` is incomplete")
            return None
        *ranges, body = parts
        each = [self._members(r) for r in ranges]
        for part in (part for part, (_, names) in zip(ranges, each, strict=True) if not names):
            self.missing.add(part, "no object has this variable's type")
        if not all(names for _, names in each):
            return None
        if not pairs:
            variable, names = each[0]
            found = [self.condition(body, {**scope, variable: name}) for name in names]
            if group.head == "forn":
                return self._exactly(group, int(number), found)
            return self._joined("all" if group.head == "forall" else "any", found)
        (first, rows), (second, columns) = each
        choices = [(a, b) for a, b in product(rows, columns) if a != b]
        cells = {(a, b): self.condition(body, {**scope, first: a, second: b}) for a, b in choices}
        if group.head == "fornpairs":
            return self._exactly(group, int(number), list(cells.values()))
        sides = []
        for k, names in enumerate((rows, columns)):
            partners = [[cell for pair, cell in cells.items() if pair[k] == name] for name in names]
            found = [self._joined("any", one) for one in partners]
            sides.append(self._at_least(group, min(len(rows), len(columns)), found))
        return self._joined("all", sides)

    def _at_least(self, group: BddlGroup, least: int, found: list[Condition | None]) -> Condition | None:
        """Return a condition that is true if at least ``least`` of the conditions are true."""
        if not self._affordable(group, len(found), least):
            return None
        if least == len(found):
            return self._joined("all", found)
        return self._joined("any", [self._joined("all", list(chosen)) for chosen in combinations(found, least)])

    def _exactly(self, group: BddlGroup, count: int, found: list[Condition | None]) -> Condition | None:
        """Return a condition that is true if exactly ``count`` of the conditions are true."""
        if count > len(found):
            self.missing.add(group, f"exactly {count} conditions must be true, but there are only {len(found)}")
            return None
        if not self._affordable(group, len(found), count):
            return None
        choices = [
            self._joined("all", [one if k in chosen else negated(one) for k, one in enumerate(found)])
            for chosen in combinations(range(len(found)), count)
        ]
        return self._joined("any", choices)

    def _affordable(self, group: BddlGroup, of: int, chosen: int) -> bool:
        self.terms += comb(of, chosen) * of
        if self.terms > MOST_TERMS:
            self.missing.add(group, f"the condition expands to more than {MOST_TERMS} predicates")
        return self.terms <= MOST_TERMS

    def _joined(self, key: str, found: list[Condition | None]) -> Condition | None:
        if not found or any(one is None for one in found):
            return None
        return found[0] if len(found) == 1 else {key: tuple(found)}

    def _members(self, group: BddlGroup) -> tuple[str, Sequence[str]]:
        """Return the variable in ``(?x - type)`` and the objects over which it ranges."""
        words = [item for item in group.items if isinstance(item, BddlWord)]
        if len(words) != 3 or words[1].text != "-":
            return "", ()
        return words[0].plain, self.objects.get(words[2].plain, ())


def negated(condition: Condition | None) -> Condition | None:
    """Return the negation of a condition.

    `not` is applied only to individual predicates, and `Closed` is negated as `Open`.
    """
    if condition is None:
        return None
    if isinstance(condition, dict):
        ((key, below),) = condition.items()
        if key == "not":
            return below
        return {"any" if key == "all" else "all": tuple(negated(one) for one in below)}
    for word, other in (("Open(", "Closed("), ("Closed(", "Open(")):
        if condition.startswith(word):
            return other + condition.removeprefix(word)
    return {"not": condition}
