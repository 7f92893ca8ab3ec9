"""Import of LIBERO and BEHAVIOR tasks in the Behavior Domain Definition Language (BDDL)."""

from simfoundry.frontends.bddl.problem import BddlProblem, read_problem
from simfoundry.frontends.bddl.task import read_bddl_task

__all__ = ["BddlProblem", "read_bddl_task", "read_problem"]
