"""Declarations of predicates (name, arguments, and meaning) without numpy.

Each predicate is a :class:`Predicate` in a module of :mod:`simfoundry.predicates`, or one to which an entry point of
another package refers, in the group ``simfoundry.predicates``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache
from types import MappingProxyType

from simfoundry.runtime.plugins import PluginError, Registry


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
