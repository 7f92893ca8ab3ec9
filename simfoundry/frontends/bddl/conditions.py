"""Convert BDDL conditions: quantifiers become `all`, `any` and `not` over the scene's objects.

Quantifiers have the semantics of the `bddl` package: `forn` requires exactly n objects and `fornpairs` exactly n pairs;
`forpairs` requires a partner for as many objects as the smaller of the two groups contains.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations, product
from math import comb
from typing import Any

from simfoundry.frontends.bddl.problem import BddlGroup, BddlWord

MOST_TERMS = 20_000
"""Largest number of predicates in an expanded goal; quantifiers over many objects grow combinatorially."""

Condition = Any
"""Predicate, or a mapping with `all`, `any` or `not`, as in a document."""

Scope = Mapping[str, str]
"""Objects by the names of the variables bound to them."""


@dataclass
class ConditionReader:
    """Converts conditions; ``atom`` creates a predicate from its name and arguments, ``objects`` are listed by type."""

    atom: Callable[[BddlGroup, str, list[str]], Condition | None]
    objects: Mapping[str, Sequence[str]]
    missing: list[str] = field(default_factory=list)
    terms: int = 0

    def condition(self, group: BddlGroup, scope: Scope) -> Condition | None:
        """Return one condition; None if a part of it is missing, which is then listed in ``missing``."""
        match group.head:
            case "and" | "or":
                return self._joined(
                    "all" if group.head == "and" else "any", [self.condition(g, scope) for g in group.groups]
                )
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
        count = self._number(parts.pop(0)) if numbered and parts else 0
        if len(parts) != (3 if pairs else 2) or count is None:
            self._lack(group, f"`{group.head}` is not complete")
            return None
        *ranges, body = parts
        each = [self._members(r) for r in ranges]
        if any(not names for _, names in each):
            for part, (_, names) in zip(ranges, each, strict=True):
                if not names:
                    self._lack(part, "it ranges over a type that nothing has")
            return None
        if not pairs:
            variable, names = each[0]
            found = [self.condition(body, {**scope, variable: name}) for name in names]
            if group.head == "forn":
                return self._exactly(group, count, found)
            return self._joined("all" if group.head == "forall" else "any", found)
        (first, rows), (second, columns) = each
        table = [
            [self.condition(body, {**scope, first: a, second: b}) if a != b else None for b in columns] for a in rows
        ]
        if group.head == "fornpairs":
            cells = [table[i][j] for (i, a), (j, b) in product(enumerate(rows), enumerate(columns)) if a != b]
            return self._exactly(group, count, cells)
        return self._paired(group, table, rows, columns)

    def _paired(
        self, group: BddlGroup, table: list[list[Condition | None]], rows: Sequence[str], columns: Sequence[str]
    ) -> Condition | None:
        least = min(len(rows), len(columns))
        lines = [[cell for k, cell in enumerate(line) if rows[i] != columns[k]] for i, line in enumerate(table)]
        turned = [[line[k] for i, line in enumerate(table) if rows[i] != columns[k]] for k in range(len(columns))]
        sides = [self._at_least(group, least, [self._joined("any", one) for one in side]) for side in (lines, turned)]
        return self._joined("all", sides)

    def _at_least(self, group: BddlGroup, least: int, found: list[Condition | None]) -> Condition | None:
        """Return the condition that at least ``least`` of the conditions hold."""
        if not self._affordable(group, len(found), least):
            return None
        if least == len(found):
            return self._joined("all", found)
        return self._joined("any", [self._joined("all", list(chosen)) for chosen in combinations(found, least)])

    def _exactly(self, group: BddlGroup, count: int, found: list[Condition | None]) -> Condition | None:
        """Return the condition that exactly ``count`` of the conditions hold."""
        if count > len(found):
            self._lack(group, f"{count} are to hold of {len(found)}")
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
            self._lack(group, f"written out it is more than {MOST_TERMS} predicates")
        return self.terms <= MOST_TERMS

    def _joined(self, key: str, found: list[Condition | None]) -> Condition | None:
        if not found or any(one is None for one in found):
            return None
        return found[0] if len(found) == 1 else {key: tuple(found)}

    def _members(self, group: BddlGroup) -> tuple[str, Sequence[str]]:
        """Return the variable of ``(?x - type)`` and the objects that it ranges over."""
        words = [item for item in group.items if isinstance(item, BddlWord)]
        if len(words) != 3 or words[1].text != "-":
            return "", ()
        return words[0].plain, self.objects.get(words[2].plain, ())

    def _number(self, group: BddlGroup) -> int | None:
        return int(group.head) if group.head.isdigit() and len(group.head) < 6 else None

    def _lack(self, group: BddlGroup, what: str) -> None:
        """Record a missing element once."""
        text = f"line {group.line}: {what}"
        if text not in self.missing:
            self.missing.append(text)


def negated(condition: Condition | None) -> Condition | None:
    """Return the negation of a condition, with `not` only before predicates; `Open` negates `Closed`."""
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
