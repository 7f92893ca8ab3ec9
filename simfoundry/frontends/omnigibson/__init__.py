"""The importer for OmniGibson scenes and tasks as published in the authors' release."""

from simfoundry.frontends.registry import Importer, deferred

IMPORTER = Importer(
    {".json": deferred("simfoundry.frontends.omnigibson.scene:read_omnigibson")},
    dict.fromkeys((".yaml", ".yml"), deferred("simfoundry.frontends.omnigibson.task:read_task")),
)
