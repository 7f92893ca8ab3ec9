"""Predicates: whether a cup is on a plate, in any state, the same for every simulator (docs/predicates.md)."""

from simfoundry.predicates.judging.bodies import PredicateError
from simfoundry.predicates.judging.judge import Judge, Verdict
from simfoundry.predicates.judging.states import Poses, StateBatch

__all__ = ["Judge", "Poses", "PredicateError", "StateBatch", "Verdict"]
