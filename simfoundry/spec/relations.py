"""Relations as people write them: ``OnTop(cup, desk)``, ``Closed(cabinet.drawer)``."""

from __future__ import annotations

import re

PREDICATES = {
    "OnTop": 2,
    "Inside": 2,
    "Under": 2,
    "NextTo": 2,
    "Touching": 2,
    "LeftOf": 2,
    "RightOf": 2,
    "InFrontOf": 2,
    "Behind": 2,
    "Open": 1,
    "Closed": 1,
    "Upright": 1,
}
"""The predicates a relation may use, with the number of their arguments."""

_CALL = re.compile(r"\s*([A-Za-z]\w*)\s*\(([^()]*)\)\s*\Z")
_ARGUMENT = re.compile(r"[a-z][a-z0-9_]*(\.[a-z][a-z0-9_]*)?\Z")


class RelationError(ValueError):
    """A text that is not a relation; ``word`` is the part to blame, ``choices`` what it could have been."""

    def __init__(self, message: str, word: str = "", choices: tuple[str, ...] = ()) -> None:
        super().__init__(message)
        self.word, self.choices = word, choices


def parse_relation(text: str) -> tuple[str, tuple[str, ...]]:
    """Predicate and arguments of a relation; raises :class:`RelationError`."""
    match = _CALL.match(text)
    if match is None:
        raise RelationError(f"`{text}` is not of the form `Predicate(object, object)`")
    predicate, inside = match.groups()
    arguments = tuple(a.strip() for a in inside.split(","))
    if predicate not in PREDICATES:
        raise RelationError(f"`{predicate}` is not a predicate", predicate, tuple(PREDICATES))
    if len(arguments) != PREDICATES[predicate]:
        raise RelationError(f"`{predicate}` takes {PREDICATES[predicate]} arguments, not {len(arguments)}")
    for argument in arguments:
        if not _ARGUMENT.match(argument):
            raise RelationError(f"`{argument}` is not the name of an object or of an object's joint")
    return predicate, arguments
