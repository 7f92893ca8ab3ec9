"""Predicates that describe spatial relations and states of objects, evaluated in the same way for every simulator.

Each module in this package defines a group of related predicates, which :mod:`~simfoundry.predicates.judging` measures
and evaluates. Because ``simfoundry check`` imports these modules and must not load numpy, the judge is imported on
first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from simfoundry.geometry.frames import Poses
    from simfoundry.predicates.judging.bodies import PredicateError
    from simfoundry.predicates.judging.judge import Judge, Verdict
    from simfoundry.predicates.judging.view import StateBatch

_MODULES = {
    "Judge": "simfoundry.predicates.judging.judge",
    "Poses": "simfoundry.geometry.frames",
    "PredicateError": "simfoundry.predicates.judging.bodies",
    "StateBatch": "simfoundry.predicates.judging.view",
    "Verdict": "simfoundry.predicates.judging.judge",
}

__all__ = ["Judge", "Poses", "PredicateError", "StateBatch", "Verdict"]


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module `{__name__}` has no attribute `{name}`")
    from importlib import import_module

    return getattr(import_module(_MODULES[name]), name)
