"""The importer for LIBERO and BEHAVIOR tasks written in the Behavior Domain Definition Language (BDDL)."""

from simfoundry.frontends.registry import Importer, deferred

IMPORTER = Importer(tasks={".bddl": deferred("simfoundry.frontends.bddl.task:read_bddl_task")})
