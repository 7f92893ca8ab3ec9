"""The twin of a recipe with its random values, for targets that draw them themselves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from simfoundry.assets.cache import Cache
from simfoundry.cousins.recipe.document import read_recipe
from simfoundry.errors import SimfoundryError
from simfoundry.evaluate.task import TaskSetup
from simfoundry.scene.lower import lower
from simfoundry.scene.model import Scene
from simfoundry.scene.objects import Progress
from simfoundry.scene.random_values import lower_random_values


def recipe_scene(
    path: Path,
    cache: Cache | None = None,
    progress: Progress | None = None,
    parameters: Mapping[str, float] | None = None,
) -> Scene:
    """Lower the twin of a recipe, in the initial state of its task if it is a task, and add the random values.

    Raises:
        SimfoundryError: If the recipe is invalid, or has no `vary`.
    """
    if parameters:
        raise SimfoundryError("--set applies to scenes; a recipe sets parameters under `parameters`")
    recipe = read_recipe(path)
    if not recipe.varied:
        message = f"{path} has no `vary`, so there are no random values to compile"
        raise SimfoundryError(f"{message}; generate cousins with `simfoundry cousins`, and compile their folder")
    if recipe.task is not None:
        scene = TaskSetup(recipe.task, recipe.scene, cache=cache).lowered()
    else:
        scene = lower(recipe.scene, cache, progress)
    return replace(scene, random_values=lower_random_values(recipe.spec, recipe.varied, recipe.scene_spec))
