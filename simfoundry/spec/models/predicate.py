"""Declarations of predicates (name, arguments, and meaning) without numpy.

Each predicate is a :class:`Predicate` in a module of :mod:`simfoundry.predicates`, or one to which an entry point of
another package refers, in the group ``simfoundry.predicates``.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import Discriminator, Field, Tag, create_model

from simfoundry.runtime.plugins import PluginError, Registry
from simfoundry.spec.models.base import Model


class Effect(StrEnum):
    """Change that a robot must make for a predicate to become true."""

    NONE = "none"
    """No change that the robot must reach for."""
    MOVE = "move"
    """Move the first argument, by pushing or otherwise."""
    GRASP = "grasp"
    """Grasp the first argument between the fingers."""
    PLACE = "place"
    """Grasp the first argument and put it onto or into the second."""
    JOINT = "joint"
    """Move the joint that the first argument names."""

    @property
    def grasps(self) -> bool:
        """Return True if the first argument must fit between the fingers."""
        return self in (Effect.GRASP, Effect.PLACE)

    @property
    def moves_object(self) -> bool:
        """Return True if the first argument must be moved as a whole."""
        return self.grasps or self is Effect.MOVE


@dataclass(frozen=True)
class Predicate:
    """Declaration of a predicate and the rule that evaluates it.

    ``parameters`` are the kinds of the arguments: ``thing`` is an object or a part of one, ``body`` is a thing or a
    robot, ``joint`` is an object (meaning all of its joints) or one of its joints; the others are ``robot`` and
    ``number``. The last ``optional`` arguments may be omitted.

    ``rule`` is called with :class:`~simfoundry.predicates.judging.judge.Terms` and the arguments, and adds the
    conditions that must hold to the terms. ``simfoundry check`` imports its module, so numpy is imported only inside
    the rule. ``definition`` describes when the predicate is true, including thresholds; ``unit`` is the unit of its
    margin.

    ``aliases`` are the names in other formats; for those in ``robot_first`` the robot comes before the object.
    ``before_motion`` is the value before any robot has moved; None if it depends on the scene.
    """

    name: str
    meaning: str
    parameters: tuple[str, ...]
    rule: Callable[..., None]
    definition: str
    unit: str = "m"
    optional: int = 0
    effect: Effect = Effect.NONE
    aliases: tuple[str, ...] = ()
    robot_first: tuple[str, ...] = ()
    before_motion: bool | None = None

    @property
    def counts(self) -> str:
        """Return the number of arguments as text."""
        most = len(self.parameters)
        plural = "" if most == 1 else "s"
        return f"{most - self.optional} or {most} arguments" if self.optional else f"{most} argument{plural}"


PREDICATES = Registry(
    "simfoundry.predicates",
    {
        "OnTop": "simfoundry.predicates.contact:ON_TOP",
        "Inside": "simfoundry.predicates.contact:INSIDE",
        "Under": "simfoundry.predicates.relative:UNDER",
        "Above": "simfoundry.predicates.relative:ABOVE",
        "NextTo": "simfoundry.predicates.relative:NEXT_TO",
        "Touching": "simfoundry.predicates.contact:TOUCHING",
        "LeftOf": "simfoundry.predicates.relative:LEFT_OF",
        "RightOf": "simfoundry.predicates.relative:RIGHT_OF",
        "InFrontOf": "simfoundry.predicates.relative:IN_FRONT_OF",
        "Behind": "simfoundry.predicates.relative:BEHIND",
        "At": "simfoundry.predicates.pose:AT",
        "Open": "simfoundry.predicates.pose:OPEN",
        "Closed": "simfoundry.predicates.pose:CLOSED",
        "Upright": "simfoundry.predicates.pose:UPRIGHT",
        "Lifted": "simfoundry.predicates.holding:LIFTED",
        "Grasped": "simfoundry.predicates.holding:GRASPED",
        "Released": "simfoundry.predicates.holding:RELEASED",
    },
    Predicate,
)
"""Predicates by name."""


def built_in_predicates() -> dict[str, Predicate]:
    """Return the built-in predicates by name, for schemas and pages, which must not depend on installed plug-ins."""
    return {name: PREDICATES.load(name) for name in PREDICATES.built_in}


def canonical(name: str, arguments: tuple[str, ...]) -> tuple[str, tuple[str, ...]]:
    """Return the canonical name and arguments of a predicate; unknown names are returned unchanged."""
    if name in PREDICATES.built_in:
        return name, arguments
    found = _by_alias(tuple(PREDICATES.built_in)).get(name)
    if found is None and name not in PREDICATES:
        found = _by_alias(tuple(PREDICATES.names())).get(name)
    if found is None:
        return name, arguments
    return found.name, arguments[::-1] if name in found.robot_first and len(arguments) == 2 else arguments


@lru_cache(maxsize=4)
def _by_alias(names: tuple[str, ...]) -> Mapping[str, Predicate]:
    """Return the predicates by alias; the first predicate with an alias wins, and broken plug-ins are skipped."""
    found: dict[str, Predicate] = {}
    for name in names:
        try:
            predicate = PREDICATES.load(name)
        except PluginError:
            continue
        for alias in predicate.aliases:
            found.setdefault(alias, predicate)
    return MappingProxyType(found)


_CALL = re.compile(r"\s*([A-Za-z]\w*)\s*\(([^()]*)\)\s*\Z")
_ARGUMENT = re.compile(r"[a-z][a-z0-9_]*(\.[a-z][a-z0-9_]*)?\Z")
_NUMBER = re.compile(r"[-+]?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][-+]?[0-9]{1,3})?\Z")


class ExpressionError(ValueError):
    """Error for a text that is not a predicate; ``word`` is the faulty part, and ``choices`` are the valid values."""

    def __init__(self, message: str, word: str = "", choices: tuple[str, ...] = ()) -> None:
        super().__init__(message)
        self.word, self.choices = word, choices


@dataclass(frozen=True)
class Call:
    """Predicate with its arguments and their kinds."""

    predicate: str
    args: tuple[str, ...]

    @property
    def declaration(self) -> Predicate:
        """Return the declaration of the predicate."""
        return PREDICATES.load(self.predicate)

    @property
    def kinds(self) -> tuple[str, ...]:
        """Return the kind of each argument."""
        return self.declaration.parameters[: len(self.args)]

    def __str__(self) -> str:
        return f"{self.predicate}({', '.join(self.args)})"


@lru_cache(maxsize=1024)  # checks, lowering and predicates parse the same few expressions
def parse_call(text: str) -> Call:
    """Parse a predicate by its name or an alias; raises :class:`ExpressionError`."""
    match = _CALL.match(text)
    if match is None:
        raise ExpressionError(f"`{text[:80]}` is not of the form `Predicate(object, object)`")
    name, inside = match.groups()
    name, arguments = canonical(name, tuple(a.strip() for a in inside.split(",")) if inside.strip() else ())
    if name not in PREDICATES:
        raise ExpressionError(f"`{name}` is not a predicate", name, tuple(PREDICATES.names()))
    try:
        predicate = PREDICATES.load(name)
    except PluginError as error:
        raise ExpressionError(str(error)) from error
    if not len(predicate.parameters) - predicate.optional <= len(arguments) <= len(predicate.parameters):
        raise ExpressionError(f"`{name}` takes {predicate.counts}, not {len(arguments)}")
    for argument, kind in zip(arguments, predicate.parameters, strict=False):
        if kind == "number" and not _NUMBER.match(argument):
            raise ExpressionError(f"`{argument}` is not a number, which `{name}` takes here")
        if kind != "number" and not _ARGUMENT.match(argument):
            raise ExpressionError(f"`{argument}` is not the name of an object or of a part of one")
    return Call(name, arguments)


def _tag(value: Any) -> str:
    if isinstance(value, Model):
        return next(iter(type(value).model_fields))
    if isinstance(value, dict):
        return next((k for k in ("all", "any", "not") if k in value), "all")
    return "text"


class AllOf(Model):
    """True if all conditions hold."""

    all: tuple[Condition, ...] = Field(description="Conditions that must all hold.")


class AnyOf(Model):
    """True if at least one condition holds."""

    any: tuple[Condition, ...] = Field(description="Conditions of which at least one must hold.")


# `not` is a Python keyword, so this model cannot be defined with a class statement.
NoneOf: type[Model] = create_model(
    "NoneOf",
    __base__=Model,
    __module__=__name__,
    __doc__="True if the condition does not hold.",
    **{"not": ("Condition", Field(description="A condition that must not hold."))},  # type: ignore[call-overload]
)

if TYPE_CHECKING:  # type checkers do not support this recursive type
    Condition = str | Model
else:
    Condition = Annotated[
        Annotated[str, Tag("text")]
        | Annotated[AllOf, Tag("all")]
        | Annotated[AnyOf, Tag("any")]
        | Annotated[NoneOf, Tag("not")],
        Discriminator(_tag),
    ]
    """Predicate, or a combination of several."""


def parts(condition: Any) -> tuple[str, tuple[Any, ...]]:
    """Return ``text``, ``all``, ``any`` or ``not`` for a condition (typed or plain data), and its operands."""
    tag = _tag(condition)
    if tag == "text":
        return tag, (condition,)
    below = condition.get(tag) if isinstance(condition, dict) else getattr(condition, tag)
    return tag, (below,) if tag == "not" else tuple(below) if isinstance(below, tuple | list) else ()


def texts(condition: Any, path: tuple[str | int, ...] = ()) -> Iterator[tuple[str, tuple[str | int, ...]]]:
    """Yield every predicate of a condition as written, with its path."""
    tag, below = parts(condition)
    if tag == "text":
        if isinstance(condition, str):
            yield condition, path
    elif tag == "not":
        yield from texts(below[0], (*path, tag))
    else:
        for k, item in enumerate(below):
            yield from texts(item, (*path, tag, k))
