"""Variations of the pictures of demonstrations, drawn from a recipe that changes nothing else."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from simfoundry.cousins.randomization.varied_twin import VariedScenes
from simfoundry.cousins.recipe.document import Recipe, read_recipe
from simfoundry.errors import SimfoundryError
from simfoundry.evaluate.task import Task
from simfoundry.scene.model import Scene
from simfoundry.scene.physics import differs_only_in_pictures


@dataclass(frozen=True)
class PictureSource:
    """The recipe from which pictures are drawn.

    Attributes:
        recipe: The path of the recipe.
        seed: The seed of the random choices.
        split: The split of the recipe, or an empty string for all values.
    """

    recipe: Path
    seed: int
    split: str = ""


@dataclass(frozen=True, eq=False)
class VariedPictures:
    """A scene with drawn values.

    Attributes:
        scene: The scene in the initial state of the task.
        instruction: The drawn instruction, or an empty string if it does not vary.
        values: The drawn values by path.
        split: The split from which they were drawn.
    """

    scene: Scene
    instruction: str
    values: dict[str, object]
    split: str


class PictureSampler:
    """Draws pictures for the demonstrations of one task. The recipe is applied to the scene of that task."""

    def __init__(self, source: PictureSource, task: Task) -> None:
        recipe = read_recipe(source.recipe, source.seed, source.split)
        check_recipe(recipe)
        self._task, self._path = task, source.recipe
        own = replace(recipe, scene=task.setup.scene, task=task.setup.task)
        self._scenes = VariedScenes.of_pictures(own, task.scene)

    @property
    def varies_instruction(self) -> bool:
        """True if the recipe varies the instruction."""
        return "instruction" in self._scenes.recipe.spec.vary

    def instruction(self, index: int) -> str:
        """Return the drawn instruction, or an empty string if it does not vary."""
        document = self._scenes.draw_pictures(index).documents.get("task", {})
        return str(document.get("instruction", ""))

    def sample(self, index: int) -> VariedPictures:
        """Return the scene with the values that are drawn for an index.

        Raises:
            SimfoundryError: If the values change more than the pictures.
        """
        drawn = self._scenes.draw_pictures(index)
        scene = self._scenes.lowered(index, drawn)
        if not differs_only_in_pictures(scene, self._task.scene):
            raise SimfoundryError(
                f"recipe {self._path} changes more than the pictures of task `{self._task.name}`, so recorded "
                "demonstrations do not apply to its scenes; vary only cameras, lights, colors, textures and "
                "backgrounds, or record demonstrations of its cousins"
            )
        return VariedPictures(scene, self.instruction(index), dict(drawn.values), drawn.split)


def check_recipe(recipe: Recipe) -> None:
    """Check that a recipe has no axis other than `vary`.

    Raises:
        SimfoundryError: If it has.
    """
    spec = recipe.spec
    for axis in ("scene", "object", "distractors", "task"):
        if getattr(spec, axis) is not None:
            raise SimfoundryError(
                f"recipe {recipe.loaded.path} has the axis `{axis}`, which changes more than pictures; "
                "use a recipe that has only `vary`"
            )
