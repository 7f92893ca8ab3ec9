"""Predicate declarations (name, arguments, and meaning) that do not require numpy.

Each predicate is a :class:`Predicate` instance in a module of :mod:`simfoundry.predicates`, or is provided by another
package through an entry point in the ``simfoundry.predicates`` group.
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

from simfoundry.errors import SimfoundryError
from simfoundry.runtime.plugins import PluginError, Registry
from simfoundry.spec.diagnostics import Fix, nearest, similar_fixes
from simfoundry.spec.models.base import FARTHEST, Model


class Effect(StrEnum):
    """The change that a robot must make for a predicate to become true."""

    NONE = "none"
    """The robot does not need to reach any object."""
    MOVE = "move"
    """Move the first argument, by pushing or otherwise."""
    GRASP = "grasp"
    """Grasp the first argument between the fingers."""
    PLACE = "place"
    """Grasp the first argument and put it onto or into the second."""
    JOINT = "joint"
    """Move the joint named by the first argument."""

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
    """The declaration of a predicate, and the rule that evaluates it.

    Attributes:
        name: Name of the predicate in expressions.
        meaning: Short description of the predicate.
        parameters: Kind of each argument. ``thing`` is an object or part of an object, ``body`` is a thing or a robot,
            and ``joint`` is a single joint, or an object, which stands for all of its joints. The remaining kinds are
            ``robot`` and ``number``.
        rule: Function called with :class:`~simfoundry.predicates.judging.judge.Terms` and the arguments; it adds the
            required conditions to the terms. ``simfoundry check`` imports the module that defines the rule, so numpy
            must be imported inside the function.
        definition: Exact condition under which the predicate is true, including thresholds.
        unit: Unit of the margin.
        scale: Margin at which the score is one half, in the unit of the margin. By default, it depends on the unit; see
            :data:`simfoundry.predicates.judging.thresholds.SCORE_SCALES`.
        optional: Number of trailing arguments that may be omitted.
        effect: Change that a robot must make for the predicate to become true.
        aliases: Names of the predicate in other formats.
        robot_first: Aliases whose arguments list the robot before the object.
        before_motion: Value before any robot has moved, or None if it depends on the scene.
        contact: True if the predicate can hold only when its two objects, or its object and the robot, touch or
            overlap. Rollouts then skip the rule while the two are far apart.
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
    contact: bool = False
    scale: float | None = None

    @property
    def counts(self) -> str:
        """Return the accepted number of arguments as text, such as ``1 or 2 arguments``."""
        most = len(self.parameters)
        plural = "" if most == 1 else "s"
        return f"{most - self.optional} or {most} arguments" if self.optional else f"{most} argument{plural}"


# Registry of predicates by name.
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


def built_in_predicates() -> dict[str, Predicate]:
    """Return the built-in predicates by name.

    Schemas and documentation use these predicates because they must not depend on the installed plug-ins.
    """
    return {name: PREDICATES.load(name) for name in PREDICATES.built_in}


def canonical(name: str, arguments: tuple[str, ...]) -> tuple[str, tuple[str, ...]]:
    """Resolve aliases, and return the canonical name and arguments. Unknown names are returned unchanged."""
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
    """Return a mapping from alias to predicate.

    If several predicates share an alias, the first one wins. Broken plug-ins are skipped.
    """
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


class ExpressionError(SimfoundryError, ValueError):
    """Raised if a text is not a valid predicate.

    ``message`` states the problem, and ``hint`` names the valid values, if there are any. The problem is the ``word``
    at ``index`` of the text, or the whole text if ``word`` is empty; ``fixes`` contains what can be written instead.
    """

    def __init__(
        self, message: str, hint: str = "", word: str = "", index: int = 0, fixes: tuple[Fix, ...] = ()
    ) -> None:
        super().__init__(f"{message}; {hint}" if hint else message)
        self.message, self.hint = message, hint
        self.word, self.index, self.fixes = word, index, fixes


@dataclass(frozen=True)
class Call:
    """A predicate applied to arguments."""

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


def argument_indices(text: str) -> tuple[int, ...]:
    """Return where each argument starts in the text of a valid predicate, in the order of :attr:`Call.args`."""
    match = _CALL.match(text)
    if match is None:
        return ()
    starts = [start for start, _ in _arguments(match)]
    in_order = canonical(match[1], tuple(map(str, starts)))[1]
    return tuple(map(int, in_order))


def _arguments(match: re.Match[str]) -> Iterator[tuple[int, str]]:
    """Yield the index and text of each argument."""
    start = match.start(2)
    for part in match[2].split(",") if match[2].strip() else ():
        yield start + len(part) - len(part.lstrip()), part.strip()
        start += len(part) + 1


@lru_cache(maxsize=1024)  # checks, lowering and predicates parse the same few expressions
def parse_call(text: str) -> Call:
    """Parse a predicate given by its name or an alias.

    Raises:
        ExpressionError: If the text is not a valid predicate.
    """
    match = _CALL.match(text)
    if match is None:
        raise ExpressionError(f"`{text[:80]}` is not of the form `Predicate(object, object)`")
    written = tuple(argument for _, argument in _arguments(match))
    name, arguments = canonical(match[1], written)
    if name not in PREDICATES:
        hint, fixes = nearest(name, PREDICATES.names()), similar_fixes(name, PREDICATES.names())
        raise ExpressionError(f"`{name}` is not a predicate", hint, name, match.start(1), fixes)
    try:
        predicate = PREDICATES.load(name)
    except PluginError as error:
        raise ExpressionError(str(error)) from error
    if not len(predicate.parameters) - predicate.optional <= len(arguments) <= len(predicate.parameters):
        raise ExpressionError(f"`{name}` takes {predicate.counts}, not {len(arguments)}")
    for argument, kind, index in zip(arguments, predicate.parameters, argument_indices(text), strict=False):
        problem = ""
        if kind == "number" and not _NUMBER.match(argument):
            problem = f"`{argument}` is not a number, but `{name}` requires one here"
        elif kind == "number" and abs(float(argument)) > FARTHEST:
            problem = f"`{argument}` is out of range; numbers in predicates are at most {FARTHEST:.0f}"
        elif kind != "number" and not _ARGUMENT.match(argument):
            problem = f"`{argument}` is not the name of an object or of an object's part"
        if problem:
            raise ExpressionError(problem, word=argument, index=index)
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

    any: tuple[Condition, ...] = Field(description="Conditions, at least one of which must hold.")


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
    """A predicate, or a combination of conditions."""


def parts(condition: Any) -> tuple[str, tuple[Any, ...]]:
    """Split a condition (a model or plain data) into its kind and its operands.

    The kind is ``text``, ``all``, ``any`` or ``not``.
    """
    tag = _tag(condition)
    if tag == "text":
        return tag, (condition,)
    below = condition.get(tag) if isinstance(condition, dict) else getattr(condition, tag)
    return tag, (below,) if tag == "not" else tuple(below) if isinstance(below, tuple | list) else ()


def texts(condition: Any, path: tuple[str | int, ...] = ()) -> Iterator[tuple[str, tuple[str | int, ...]]]:
    """Yield the text of every predicate in a condition together with its path."""
    tag, below = parts(condition)
    if tag == "text":
        if isinstance(condition, str):
            yield condition, path
    elif tag == "not":
        yield from texts(below[0], (*path, tag))
    else:
        for k, item in enumerate(below):
            yield from texts(item, (*path, tag, k))
