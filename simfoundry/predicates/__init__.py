"""Predicates: whether a cup is on a plate, in any state, the same for every simulator (docs/predicates.md)."""

from simfoundry.geometry.poses import Poses
from simfoundry.predicates.batch import StateBatch
from simfoundry.predicates.judge import Judge, Verdict
from simfoundry.predicates.shapes import PredicateError

__all__ = ["Judge", "Poses", "PredicateError", "StateBatch", "Verdict"]
