"""Register ``SimFoundry/Task-v0`` with Gymnasium on import.

Simulators are loaded when an environment is created. ``gymnasium.make("simfoundry.evaluate.gym:SimFoundry/Task-v0",
task="my.task.yaml")`` imports this module implicitly.
"""

from __future__ import annotations

from gymnasium.envs.registration import register, registry

ENV_ID = "SimFoundry/Task-v0"

if ENV_ID not in registry:
    register(ENV_ID, entry_point="simfoundry.evaluate.env:TaskEnv")
