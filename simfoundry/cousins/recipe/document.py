"""A recipe with its twin: the documents, the axes, and the fingerprint of a run."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from simfoundry.assets.cache import Cache
from simfoundry.cousins.recipe.library import LibraryItem, default_folder, filtered, read_library, remarks, united
from simfoundry.errors import OutputError
from simfoundry.runtime.files import write_atomically
from simfoundry.scene.lower import lower
from simfoundry.scene.model import SceneObject
from simfoundry.spec.diagnostics import SpecError
from simfoundry.spec.files import located
from simfoundry.spec.load import load_kind
from simfoundry.spec.loaded import Loaded
from simfoundry.spec.models.cousins import CousinsSpec
from simfoundry.spec.models.scene import SceneSpec
from simfoundry.spec.models.task import TaskSpec
from simfoundry.spec.project import NoProjectError, common_project, markers
from simfoundry.spec.yaml.write import to_data

NOT_COUNTED = ("simfoundry", "extends", "name", "description", "allow", "conflicts", "count", "seed")
"""Fields of a recipe that do not affect a candidate, and the seed, which may be given with the run."""


@dataclass(frozen=True, eq=False)
class Recipe:
    """A checked recipe. ``scene`` is the document of the twin's scene, ``task`` that of the twin if it is a task."""

    loaded: Loaded
    scene: Loaded
    task: Loaded | None
    seed: int

    @property
    def spec(self) -> CousinsSpec:
        """The recipe's document."""
        assert isinstance(self.loaded.spec, CousinsSpec)
        return self.loaded.spec

    @property
    def scene_spec(self) -> SceneSpec:
        """The document of the twin's scene."""
        assert isinstance(self.scene.spec, SceneSpec)
        return self.scene.spec

    @property
    def task_spec(self) -> TaskSpec | None:
        """The document of the twin's task, if it is a task."""
        return self.task.spec if self.task is not None and isinstance(self.task.spec, TaskSpec) else None

    @property
    def twin_file(self) -> Path:
        """Path of the twin's document."""
        return (self.task or self.scene).path

    @property
    def distractors(self) -> tuple[LibraryItem, ...]:
        """Objects that may be added as distractors; raises :class:`ImpossibleError` if there are none."""
        return self._choice[0]

    @property
    def remarks(self) -> tuple[str, ...]:
        """Return notes for the user on the choice of distractors."""
        return self._choice[1]

    @cached_property
    def _choice(self) -> tuple[tuple[LibraryItem, ...], tuple[str, ...]]:
        axis = self.spec.distractors
        if axis is None:
            return (), ()
        folders = [] if axis.library is None else [located(axis.library, self.loaded.path)]
        folders += [default_folder()] if axis.builtin_library else []
        library = united([read_library(folder) for folder in folders])
        items, steps = filtered(library, axis, self.kinds, lambda: self._lowered)
        return items, remarks(library, items, steps)

    @cached_property
    def _lowered(self) -> tuple[SceneObject, ...]:
        return lower(self.scene, Cache.default()).objects

    @cached_property
    def kinds(self) -> tuple[str, ...]:
        """Words for the objects of the twin, sorted: their names, labels, and categories or asset names."""
        from simfoundry.spec.models.asset import AssetSpec

        found = set()
        for name, item in self.scene_spec.objects.items():
            asset = self.scene.used(item.asset) if item.asset is not None else None
            spec = asset.spec if asset is not None and isinstance(asset.spec, AssetSpec) else None
            found |= {name, item.category or (spec.category or spec.name if spec is not None else name), *item.labels}
        return tuple(sorted(found))

    def about(self) -> dict[str, Any]:
        """Return the run's fingerprint; equal fingerprints give equal bytes."""
        from simfoundry.targets.inputs import record

        inputs = record(self.scene, ())
        inputs["task"] = None if self.task_spec is None else to_data(self.task_spec)
        inputs["library"] = [[item.name, item.digest] for item in self.distractors]
        inputs["objects"] = self._object_files()
        axes = {key: value for key, value in to_data(self.spec).items() if key not in (*NOT_COUNTED, "twin")}
        return {
            "recipe": self.spec.name,
            "seed": self.seed,
            "axes": _hash(axes),
            "twin": _hash(inputs),
            "generator": f"simfoundry {inputs['software']['simfoundry']}",
        }

    def _object_files(self) -> dict[str, str]:
        """Return the contents of the object axis's library."""
        axis = self.spec.object
        if axis is None or axis.library is None:
            return {}
        from simfoundry.cousins.objects.retrieval import contents

        return contents(located(axis.library, self.loaded.path))


def _hash(data: object) -> str:
    return hashlib.sha256(json.dumps(data, ensure_ascii=False, sort_keys=True, default=list).encode()).hexdigest()


def read_recipe(path: Path, seed: int | None = None) -> Recipe:
    """Read a recipe and its twin; raises :class:`SpecError` with every finding."""
    loaded = load_kind(path, "cousins/1")
    spec = loaded.spec
    assert isinstance(spec, CousinsSpec)
    twin = loaded.used(spec.twin)
    task = twin if twin is not None and isinstance(twin.spec, TaskSpec) else None
    scene = twin if task is None or twin is None else twin.used(task.spec.scene)  # type: ignore[union-attr]
    if scene is None or not isinstance(scene.spec, SceneSpec) or scene.path.suffix != ".yaml":
        message = f"`{spec.twin}` is not a scene or task document that another can extend"
        raise SpecError([loaded.finding("SF005", ("twin",), message, "give a .scene.yaml or .task.yaml")])
    return Recipe(loaded, scene, task, spec.seed if seed is None else seed)


def claim_project(recipe: Recipe, out: Path) -> Path | None:
    """Mark a common project folder of a recipe and its cousins if there is none; return the marker written, or None.

    Raises :class:`OutputError` unless documents in ``out`` can extend the twin, which requires both to be in one
    project.
    """
    try:
        project = common_project(recipe.loaded.path, recipe.scene.path, out / "cousin.scene.yaml")
    except NoProjectError:
        root = recipe.scene.root
        raise OutputError(
            f"cousins extend their twin by a relative path, so they must lie in its project, {root}; "
            f"give a folder below it, such as -o {root / 'build' / recipe.spec.name}"
        ) from None
    for marker, text in markers(project).items():
        write_atomically(marker, text.encode())
        return marker
    return None
