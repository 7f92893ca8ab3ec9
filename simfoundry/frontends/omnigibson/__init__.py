"""The importer for the OmniGibson scenes and tasks in the release that accompanies the SimFoundry paper."""

from simfoundry.frontends.registry import Importer, deferred

IMPORTER = Importer(
    {".json": deferred("simfoundry.frontends.omnigibson.scene:read_omnigibson")},
    dict.fromkeys((".yaml", ".yml"), deferred("simfoundry.frontends.omnigibson.task:read_task")),
)
