"""Predicates as the language knows them: name, arguments and meaning, without numpy.

Each predicate is one file of :mod:`simfoundry.predicates`, or an entry point of another package in the group
``simfoundry.predicates``, which holds a :class:`Predicate`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache
from types import MappingProxyType

from simfoundry.runtime.plugins import PluginError, Registry


class Effect(StrEnum):
    """The change that a robot must make for a predicate to become true."""

    NONE = "none"
    """Nothing that a robot must reach."""
    MOVE = "move"
    """Move the first argument, by pushing or otherwise."""
    GRASP = "grasp"
    """Take the first argument between the fingers."""
    PLACE = "place"
    """Grasp the first argument and put it onto or into the second."""
    JOINT = "joint"
    """Move the joint that the first argument names."""

    @property
    def grasps(self) -> bool:
        """True if the first argument must fit between the fingers."""
        return self in (Effect.GRASP, Effect.PLACE)

    @property
    def moves_object(self) -> bool:
        """True if the first argument must be moved as a whole."""
        return self.grasps or self is Effect.MOVE


@dataclass(frozen=True)
class Predicate:
    """Declaration of a predicate and the rule that judges it.

    ``parameters`` are the kinds of the arguments: ``thing`` an object or a part of one, ``body`` that or a robot,
    ``joint`` an object (all of its joints) or one joint of it, ``robot``, ``number``. The last ``optional`` may be left
    out.

    ``rule`` is called with :class:`~simfoundry.predicates.judging.terms.Terms` and the arguments, and adds to the terms
    what must hold. Its file is read by ``simfoundry check``, so that numpy is imported inside the rule. ``definition``
    says when the predicate is true, with its thresholds; ``unit`` is that of its margin.

    ``aliases`` are the names that others use; with those in ``robot_first`` the robot comes before the object.
    ``before_motion`` is its value before any robot has moved, None if that depends on the scene.
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
        """Number of arguments in words."""
        most = len(self.parameters)
        plural = "" if most == 1 else "s"
        return f"{most - self.optional} or {most} arguments" if self.optional else f"{most} argument{plural}"


PREDICATES = Registry(
    "simfoundry.predicates",
    {
        "OnTop": "simfoundry.predicates.on_top:PREDICATE",
        "Inside": "simfoundry.predicates.inside:PREDICATE",
        "Under": "simfoundry.predicates.vertical:UNDER",
        "Above": "simfoundry.predicates.vertical:ABOVE",
        "NextTo": "simfoundry.predicates.next_to:PREDICATE",
        "Touching": "simfoundry.predicates.touching:PREDICATE",
        "LeftOf": "simfoundry.predicates.sides:LEFT_OF",
        "RightOf": "simfoundry.predicates.sides:RIGHT_OF",
        "InFrontOf": "simfoundry.predicates.sides:IN_FRONT_OF",
        "Behind": "simfoundry.predicates.sides:BEHIND",
        "At": "simfoundry.predicates.at:PREDICATE",
        "Open": "simfoundry.predicates.opening:OPEN",
        "Closed": "simfoundry.predicates.opening:CLOSED",
        "Upright": "simfoundry.predicates.upright:PREDICATE",
        "Lifted": "simfoundry.predicates.lifted:PREDICATE",
        "Grasped": "simfoundry.predicates.grasped:PREDICATE",
        "Released": "simfoundry.predicates.released:PREDICATE",
    },
    Predicate,
)
"""The predicates by name."""


def built_in_predicates() -> dict[str, Predicate]:
    """Return the built-in predicates by name, for schemas and pages that must not depend on installed plug-ins."""
    return {name: PREDICATES.load(name) for name in PREDICATES.built_in}


def canonical(name: str, arguments: tuple[str, ...]) -> tuple[str, tuple[str, ...]]:
    """Return a predicate and its arguments in our spelling; unknown names stay as they are."""
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
    """Return the predicates by the names that others use; the first claim wins, broken plug-ins have none."""
    found: dict[str, Predicate] = {}
    for name in names:
        try:
            predicate = PREDICATES.load(name)
        except PluginError:
            continue
        for alias in predicate.aliases:
            found.setdefault(alias, predicate)
    return MappingProxyType(found)
