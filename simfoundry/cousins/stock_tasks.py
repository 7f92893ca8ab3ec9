"""The tasks that a recipe's cousins choose from: found once for a run, by the process that begins it, and kept on disk.

A model would not say the same twice, and what affordances allow takes long to prove.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from simfoundry.cousins.log import WORK
from simfoundry.cousins.overlay import relative
from simfoundry.cousins.recipe import Recipe
from simfoundry.errors import OutputError
from simfoundry.runtime.files import write_atomically
from simfoundry.spec.check.validate import validate
from simfoundry.spec.models.task import TaskSpec
from simfoundry.spec.yaml.text import YamlError, parse
from simfoundry.spec.yaml.write import to_yaml

if TYPE_CHECKING:
    from simfoundry.cousins.tasks.choices import TaskCousin
    from simfoundry.cousins.twin import Twin

FILE = "tasks.json"


def tasks_of(recipe: Recipe, out: Path, twin: Twin, vlm: str = "") -> tuple[TaskCousin, ...]:
    """The tasks of a recipe, by rank; none where its tasks do not vary. ``vlm`` names a model that may be asked.

    Raises :class:`ImpossibleError` where nothing can be done in the twin.
    """
    from simfoundry.cousins.tasks.choices import TaskCousin, task_cousins
    from simfoundry.cousins.tasks.setting import hands_of

    axis, path = recipe.spec.task, out / WORK / FILE
    if axis is None:
        return ()
    if not path.is_file():
        asked: dict[str, Any] = {}
        if axis.proposals == "model" and vlm:
            from simfoundry.cousins.gallery import draw
            from simfoundry.models.vlm import Vlm

            asked = {"vlm": Vlm(vlm), "picture": draw(recipe.scene.path) or b""}
        reference = relative(recipe.scene.path, out)
        found, _ = task_cousins(twin, recipe.scene_spec, axis, recipe.seed, reference, **asked)
        rows = [{"task": to_yaml(one.spec), "goal": one.goal} for one in found]
        write_atomically(path, (json.dumps(rows, indent=1, ensure_ascii=False) + "\n").encode())
    hands = hands_of(recipe.scene_spec)
    kept = json.loads(path.read_text())
    return tuple(TaskCousin(_task(one["task"], path), one["goal"], hands, axis.engines) for one in kept)


def _task(text: str, path: Path) -> TaskSpec:
    """A kept task; raises :class:`OutputError` where somebody has changed it into none."""
    try:
        spec, _ = validate(TaskSpec, parse(text))
    except YamlError:
        spec = None
    if spec is None:
        raise OutputError(f"{path} is damaged; remove it, and the tasks are found anew")
    return spec
