"""What a goal asks for, however it is written: two goals of one meaning are one task."""

from __future__ import annotations

from typing import Any

from simfoundry.spec.models.expressions import Call, parse_call, parts, texts

SYMMETRIC = ("NextTo", "Touching")
"""Predicates that hold both ways."""

MIRRORED = {"Under": "Above", "RightOf": "LeftOf", "InFrontOf": "Behind"}
"""Predicates that say the same as another with its arguments changed round."""

AT_REST = ("OnTop", "Inside")
"""Predicates that ask of their first argument that nothing holds it: Released adds nothing to them."""

Meaning = tuple[Any, ...]


def meaning(goal: Any) -> Meaning:
    """A goal in one form: order, repetition and choice of words do not count, nor does Released where it is implied.

    Raises :class:`~simfoundry.spec.models.expressions.ExpressionError` for what is no goal.
    """
    found = _reduced(goal)
    if found[0] != "all":
        return found
    resting = {term[2] for term in found[1:] if term[0] == "is" and term[1] in AT_REST}
    kept = tuple(t for t in found[1:] if not (t[0] == "is" and t[1] == "Released" and t[2] in resting))
    return kept[0] if len(kept) == 1 else ("all", *kept)


def _reduced(condition: Any) -> Meaning:
    tag, below = parts(condition)
    if tag == "text":
        return ("is", *_call(parse_call(condition)))
    terms = [_reduced(item) for item in below]
    if tag == "not":
        return terms[0][1] if terms[0][0] == "not" else ("not", terms[0])
    flat = [inner for term in terms for inner in (term[1:] if term[0] == tag else (term,))]
    unique = sorted(set(flat), key=repr)
    return unique[0] if len(unique) == 1 else (tag, *unique)


def _call(call: Call) -> tuple[str, ...]:
    name, args = call.predicate, call.args
    if name in MIRRORED:
        name, args = MIRRORED[name], args[::-1]
    if name in SYMMETRIC:
        args = tuple(sorted(args))
    return name, *(f"{float(a):.4f}" if kind == "number" else a for a, kind in zip(args, call.kinds, strict=True))


def conjuncts(condition: Any) -> list[Call]:
    """The predicates that must all come true; those below ``any`` and ``not`` are left out."""
    tag, below = parts(condition)
    if tag == "text":
        return [parse_call(condition)]
    return [call for item in below for call in conjuncts(item)] if tag == "all" else []


def objects_of(condition: Any) -> tuple[str, ...]:
    """The names of the objects and robots that a goal is about, in its order."""
    calls = [parse_call(text) for text, _ in texts(condition)]
    named = [arg for call in calls for arg, kind in zip(call.args, call.kinds, strict=True) if kind != "number"]
    return tuple(dict.fromkeys(name.partition(".")[0] for name in named))


def goal_words(condition: Any) -> str:
    """A goal as one line: ``OnTop(cup, shelf) and not Inside(cup, shelf)``."""
    tag, below = parts(condition)
    if tag == "text":
        return str(condition)
    if tag == "not":
        return f"not {goal_words(below[0])}"
    words = {"all": " and ", "any": " or "}[tag].join(goal_words(item) for item in below)
    return f"({words})" if tag == "any" and len(below) > 1 else words


def branches(condition: Any) -> list[list[Call]]:
    """Ways to make a goal true: in each the predicates to bring about; what must not be is left out."""
    tag, below = parts(condition)
    if tag == "text":
        return [[parse_call(condition)]]
    if tag == "not":
        return [[]]
    if tag == "any":
        return [way for item in below for way in branches(item)][:MOST]
    ways: list[list[Call]] = [[]]
    for item in below:
        ways = [[*way, *more] for way in ways for more in branches(item)][:MOST]
    return ways


MOST = 8
"""So many ways to make a goal true are tried."""
