"""Decide whether a goal can be satisfied, and whether it can be false, from its predicates alone.

Each predicate is an unknown truth value. Only combinations that are impossible for any poses are excluded, such as
`Open` and `Closed` of one joint, or two objects that are each on top of the other.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import combinations, islice, product
from typing import Any

from simfoundry.spec.models.predicate import Call, ExpressionError, parse_call, parts, texts

# Number of different predicates up to which all combinations of their values are tried (2^10 = 1024, a few ms).
MAX_CALLS = 10

# Number of predicates up to which a goal is examined at all, which limits the work for malicious input.
MAX_WRITTEN = 100

# Pairs of predicates that cannot hold at once for the same arguments.
_EXCLUDE = [
    {"Open", "Closed"},
    {"LeftOf", "RightOf"},
    {"Behind", "InFrontOf"},
    {"Above", "Under"},
]
# Pairs of predicates that cannot hold at once for the same first object: what rests is not held, and what is lifted
# touches no support.
_EXCLUDE_FOR_OBJECT = [{"Grasped", "Released"}, {"Grasped", "OnTop"}, {"Grasped", "Inside"}, {"Lifted", "OnTop"}]

# Predicates of two objects that cannot hold in a circle, and those that cannot hold in both directions. Three sticks
# can rest on each other in a circle.
_CIRCLE_FREE = ("Inside", "LeftOf", "RightOf", "Behind", "InFrontOf")
_ONE_WAY = (*_CIRCLE_FREE, "OnTop")


def verdict(condition: Any) -> tuple[bool | None, tuple[str, ...]]:
    """Decide whether a condition is the same for all states.

    Returns:
        False if it can never hold, True if it can never be false, and None otherwise or if it is too large to decide;
        and the predicates that exclude each other, if a few of them decide this.
    """
    try:
        written = [parse_call(text) for text, _ in islice(texts(condition), MAX_WRITTEN + 1)]
    except ExpressionError:
        return None, ()
    calls = list(dict.fromkeys(written))
    if not calls or len(written) > MAX_WRITTEN:
        return None, ()
    required = list(_required(condition, True))
    for (a, wanted), (b, other) in combinations(dict.fromkeys(required), 2):
        if (a == b and wanted != other) or (wanted and other and _exclude(a, b)):
            return False, tuple(dict.fromkeys((str(a), str(b))))
    if circle := _circle(call for call, wanted in required if wanted):
        return False, circle
    if len(calls) > MAX_CALLS:
        return None, ()
    values = {_value(condition, dict(zip(calls, chosen, strict=True))) for chosen in _possible(calls)}
    return (values.pop() if len(values) == 1 else None), ()


def _required(condition: Any, wanted: bool) -> Iterator[tuple[Call, bool]]:
    """Yield the predicates that must have a value for the condition to be ``wanted``."""
    tag, below = parts(condition)
    if tag == "text":
        yield parse_call(condition), wanted
    elif tag == "not":
        yield from _required(below[0], not wanted)
    elif (tag == "all") is wanted or len(below) == 1:
        for item in below:
            yield from _required(item, wanted)


def _possible(calls: list[Call]) -> Iterator[tuple[bool, ...]]:
    excluded = [(i, j) for (i, a), (j, b) in combinations(enumerate(calls), 2) if _exclude(a, b)]
    for chosen in product((False, True), repeat=len(calls)):
        if not any(chosen[i] and chosen[j] for i, j in excluded):
            yield chosen


def _value(condition: Any, values: dict[Call, bool]) -> bool:
    tag, below = parts(condition)
    if tag == "text":
        return values[parse_call(condition)]
    if tag == "not":
        return not _value(below[0], values)
    return (all if tag == "all" else any)(_value(item, values) for item in below)


def _exclude(a: Call, b: Call) -> bool:
    """Return True if two predicates cannot both hold."""
    if a.predicate == b.predicate:
        return a.predicate in _ONE_WAY and a.args == b.args[::-1]
    pair = {a.predicate, b.predicate}
    return (pair in _EXCLUDE and a.args == b.args) or (pair in _EXCLUDE_FOR_OBJECT and a.args[0] == b.args[0])


def _circle(calls: Iterable[Call]) -> tuple[str, ...]:
    """Return predicates that put objects in or beside each other in a circle, or an empty tuple."""
    above: dict[str, dict[str, dict[str, str]]] = {}
    for call in calls:
        if call.predicate in _CIRCLE_FREE:
            above.setdefault(call.predicate, {}).setdefault(call.args[0], {})[call.args[1]] = str(call)
    for graph in above.values():
        for start in graph:
            todo: list[tuple[str, tuple[str, ...]]] = [(start, ())]
            seen: set[str] = set()
            while todo:
                at, path = todo.pop()
                for following, text in graph.get(at, {}).items():
                    if following == start:
                        return (*path, text)
                    if following not in seen:
                        seen.add(following)
                        todo.append((following, (*path, text)))
    return ()
