"""Read recipes with their twins, compute run fingerprints, and write cousins as overlay documents.

An overlay document extends the twin's document and contains only the fields that differ.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import cache, cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any

import simfoundry
from simfoundry.assets.cache import Cache
from simfoundry.cousins.objects.retrieval import contents
from simfoundry.cousins.recipe.candidate import file_of
from simfoundry.cousins.recipe.library import LibraryItem, default_folder, read_library, united
from simfoundry.cousins.recipe.library_filters import filtered, remarks
from simfoundry.errors import OutputError, SimfoundryError
from simfoundry.geometry.frames import Pose
from simfoundry.runtime.files import write_atomically
from simfoundry.scene.lower import lower
from simfoundry.scene.state import pose_spec
from simfoundry.spec.check.varied_fields import FieldFinder
from simfoundry.spec.check.vary import VariedValue, varied_values
from simfoundry.spec.diagnostics import SpecError, nearest
from simfoundry.spec.files import Loaded, located
from simfoundry.spec.load import load_kind
from simfoundry.spec.models.asset import AssetSpec
from simfoundry.spec.models.cousins import CousinsSpec
from simfoundry.spec.models.scene import SceneSpec
from simfoundry.spec.models.task import TaskSpec
from simfoundry.spec.project import NoProjectError, common_project, markers
from simfoundry.spec.yaml.tree import plain_tree
from simfoundry.spec.yaml.write import to_data, write_tree

# Recipe fields that do not affect a candidate, plus the seed, which can be overridden for a run.
NOT_COUNTED = ("simfoundry", "extends", "name", "description", "allow", "conflicts", "count", "seed")


@dataclass(frozen=True, eq=False)
class Recipe:
    """A validated recipe.

    ``scene`` is the twin's scene document. ``task`` is the twin's task document, or None if the twin is a scene.
    ``split`` is the split of `vary` to draw from, or empty to draw from all splits.
    """

    loaded: Loaded
    scene: Loaded
    task: Loaded | None
    seed: int
    split: str = ""

    @property
    def spec(self) -> CousinsSpec:
        """The content of the recipe document."""
        assert isinstance(self.loaded.spec, CousinsSpec)
        return self.loaded.spec

    @property
    def scene_spec(self) -> SceneSpec:
        """The content of the twin's scene document."""
        assert isinstance(self.scene.spec, SceneSpec)
        return self.scene.spec

    @property
    def task_spec(self) -> TaskSpec | None:
        """The content of the twin's task document, or None if the twin is a scene."""
        return self.task.spec if self.task is not None and isinstance(self.task.spec, TaskSpec) else None

    @property
    def twin_file(self) -> Path:
        """Path of the twin's task document, or of its scene document if the twin is a scene."""
        return (self.task or self.scene).path

    @property
    def distractors(self) -> tuple[LibraryItem, ...]:
        """The objects that can be added as distractors.

        Raises:
            ImpossibleError: No object passes the recipe's filters.
        """
        return self._choice[0]

    @property
    def remarks(self) -> tuple[str, ...]:
        """Notes for the user about the selection of distractors."""
        return self._choice[1]

    @cached_property
    def _choice(self) -> tuple[tuple[LibraryItem, ...], tuple[str, ...]]:
        axis = self.spec.distractors
        if axis is None:
            return (), ()
        own = [] if axis.library is None else [located(axis.library, self.loaded.path)]
        folders = [*own, default_folder()] if axis.builtin_library else own
        library = united([read_library(folder) for folder in folders])
        objects = cache(lambda: lower(self.scene, Cache.default()).objects)
        items, steps = filtered(library, axis, self.kinds, objects)
        return items, remarks(library, items, steps)

    @cached_property
    def varied(self) -> tuple[VariedValue, ...]:
        """The values that vary.

        Raises:
            SpecError: If an entry of `vary` does not fit the twin.
        """
        values, problems = varied_values(self.spec, FieldFinder(self.scene, self.task), self.loaded)
        if problems:
            found = [self.loaded.finding(p.code, ("vary", *p.at), p.message, p.hint) for p in problems]
            raise SpecError(found)
        return tuple(values)

    @property
    def varied_summary(self) -> dict[str, dict[str, str]]:
        """For each value that varies, its entry in the recipe and what depends on it, for manifests."""
        return {v.field.name: {"entry": v.entry, "effect": v.field.effect} for v in self.varied}

    @cached_property
    def kinds(self) -> tuple[str, ...]:
        """The words that denote objects in the twin, in sorted order.

        These are their names, their labels, and their categories or asset names.
        """
        found = set()
        for name, item in self.scene_spec.objects.items():
            asset = self.scene.used(item.asset) if item.asset is not None else None
            spec = asset.spec if asset is not None and isinstance(asset.spec, AssetSpec) else None
            found |= {name, item.category or (spec.category or spec.name if spec is not None else name), *item.labels}
        return tuple(sorted(found))

    def about(self) -> dict[str, Any]:
        """Return the fingerprint of the run. Runs with the same fingerprint produce identical bytes."""
        from simfoundry.targets.inputs import record

        inputs = record(self.scene, ())
        inputs["task"] = None if self.task_spec is None else to_data(self.task_spec)
        inputs["library"] = [[item.name, item.digest] for item in self.distractors]
        objects = self.spec.object
        library = None if objects is None or objects.library is None else located(objects.library, self.loaded.path)
        inputs["objects"] = {} if library is None else contents(library)
        files = (name for value in self.varied if value.field.is_file for name in value.choices.values())
        chosen = {name: located(name, self.loaded.path) for name in sorted(set(files))}
        inputs |= {"files": {n: _digest(file) for n, file in chosen.items()}} if chosen else {}
        axes = {key: value for key, value in to_data(self.spec).items() if key not in (*NOT_COUNTED, "twin")}
        return {
            "recipe": self.spec.name,
            "seed": self.seed,
            **({"split": self.split} if self.split else {}),
            "axes": _hash(axes),
            "twin": _hash(inputs),
            "generator": f"simfoundry {inputs['software']['simfoundry']}",
        }


def _hash(data: object) -> str:
    return hashlib.sha256(json.dumps(data, ensure_ascii=False, sort_keys=True, default=list).encode()).hexdigest()


def _digest(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()


def read_recipe(path: Path, seed: int | None = None, split: str = "") -> Recipe:
    """Read a recipe and its twin.

    Args:
        path: Path of the recipe document.
        seed: Seed that overrides the recipe's seed, or None.
        split: The split of `vary` to draw from, or empty to draw from all splits.

    Raises:
        SpecError: If the recipe or its twin is invalid. The error contains all findings.
        SimfoundryError: If the recipe has no such split.
    """
    loaded = load_kind(path, "cousins/1")
    spec = loaded.spec
    assert isinstance(spec, CousinsSpec)
    twin = loaded.used(spec.twin)
    task = twin if twin is not None and isinstance(twin.spec, TaskSpec) else None
    scene = twin if task is None or twin is None else twin.used(task.spec.scene)  # type: ignore[union-attr]
    if scene is None or not isinstance(scene.spec, SceneSpec) or scene.path.suffix != ".yaml":
        message = f"`{spec.twin}` is not a scene or task document that other documents can extend"
        raise SpecError([loaded.finding("SF005", ("twin",), message, "use a .scene.yaml or .task.yaml file")])
    if spec.parameters:
        changed = load_kind(scene.path, "scene/1", parameters=spec.parameters)
        scene, task = changed, None if task is None else replace(task, uses={**task.uses, str(scene.path): changed})
    if split and split not in spec.splits:
        raise SimfoundryError(f"{path} has no split `{split}`; {nearest(split, spec.splits) or 'it has no splits'}")
    return Recipe(loaded, scene, task, spec.seed if seed is None else seed, split)


def claim_project(recipe: Recipe, out: Path) -> Path | None:
    """Ensure that a recipe and its cousins in ``out`` belong to the same project.

    If necessary, a project marker is written.

    Returns:
        The path of the marker that was written, or None if the project already exists.

    Raises:
        OutputError: If documents in ``out`` cannot extend the twin because they would be in a different project.
    """
    try:
        project = common_project(recipe.loaded.path, recipe.scene.path, out / "cousin.scene.yaml")
    except NoProjectError:
        root = recipe.scene.root
        raise OutputError(
            f"cousins extend their twin by a relative path, so they must be located in its project, {root}; "
            f"specify a folder inside it, such as -o {root / 'build' / recipe.spec.name}"
        ) from None
    for marker, text in markers(project).items():
        write_atomically(marker, text.encode())
        return marker
    return None


# Maximum number of characters of the recipe's name in a cousin's name; an underscore and six digits are appended.
MOST_NAME = 57

Data = dict[str, Any]

# The entries of documents in which no values are drawn.
NO_ENTRIES: Mapping[str, Any] = MappingProxyType({})


def scene_overlay(
    recipe: Recipe,
    out: Path,
    index: int,
    changes: Mapping[str, Data],
    poses: Mapping[str, Pose],
    joints: Mapping[str, Mapping[str, float]],
    relations: tuple[str, ...],
    varied: Mapping[str, Any] = NO_ENTRIES,
) -> str:
    """Return the text of a scene document that extends the twin's scene.

    Args:
        recipe: The recipe.
        out: Folder to which the document will be written.
        index: Index of the candidate.
        changes: Changed object fields other than poses and joints, by object name, including new objects.
        poses: Poses X_WO to write, by object name.
        joints: Joint positions [m or rad] to write, by object and joint name.
        relations: All relations that hold in the scene.
        varied: Entries with drawn values, which the other entries take precedence over.
    """
    objects: dict[str, Data] = {}
    for name in dict.fromkeys((*recipe.scene_spec.objects, *changes)):
        pose = {"pose": _world_pose(recipe, name, poses[name])} if name in poses else {}
        moved = {"joints": dict(joints[name])} if joints.get(name) else {}
        objects |= {name: data} if (data := {**changes.get(name, {}), **pose, **moved}) else {}
    document = _overlay("scene/1", recipe, recipe.scene, out, index)
    parameters = {**recipe.spec.parameters, **varied.get("parameters", {})}
    document |= {"parameters": parameters} if parameters else {}
    document |= {"objects": objects} if objects else {}
    document |= {"relations": relations} if relations != recipe.scene_spec.relations else {}
    document["origin"] = origin(recipe, index)
    return write_tree(plain_tree(merged(varied, document)), SceneSpec)


def merged(base: Mapping[str, Any], over: Mapping[str, Any]) -> Data:
    """Return nested data in which ``over`` takes precedence over ``base``."""
    both = {key: merged(base[key], over[key]) for key in base if _are_mappings(base[key], over.get(key))}
    return {**base, **over, **both}


def _are_mappings(*values: object) -> bool:
    return all(isinstance(value, Mapping) for value in values)


def _world_pose(recipe: Recipe, name: str, X_WO: Pose) -> Data:
    """Return the data of a pose that replaces the pose of an object in the twin."""
    item = recipe.scene_spec.objects.get(name)
    framed = item is not None and item.place is None and item.pose.frame is not None
    return {**({"frame": None} if framed else {}), **to_data(pose_spec(X_WO))}


def task_overlay(
    recipe: Recipe,
    out: Path,
    index: int,
    moved: Collection[str],
    crowded: bool,
    varied: Mapping[str, Any] = NO_ENTRIES,
    own_scene: bool = True,
) -> str:
    """Return the text of a task document that extends the twin's task and contains the drawn values ``varied``.

    If ``own_scene`` is set, the task uses the scene cousin with the same index. The twin's start conditions for
    ``moved`` objects are removed. The twin's start regions are guaranteed to be free only in the twin's layout, so they
    are also removed if an object with a region moved, or if the scene is ``crowded``, that is, contains added objects.
    Rollouts then start from the scene's own layout.
    """
    assert recipe.task is not None and recipe.task_spec is not None
    spec = recipe.task_spec
    document = _overlay("task/1", recipe, recipe.task, out, index)
    document |= {"scene": file_of(index, "scene")} if own_scene else {}
    gone = {key: {name: None for name in getattr(spec.start, key) if name in moved} for key in ("place", "pose")}
    start = {key: names for key, names in gone.items() if names}
    document |= {"start": start} if start else {}
    if spec.reset.objects and (crowded or set(spec.reset.objects) & set(moved)):
        document["reset"] = None
    document["origin"] = origin(recipe, index)
    return write_tree(plain_tree(merged(varied, document)), TaskSpec)


def own_task(
    recipe: Recipe,
    out: Path,
    index: int,
    spec: TaskSpec,
    moved: Collection[str],
    own_scene: bool,
    varied: Mapping[str, Any] = NO_ENTRIES,
) -> str:
    """Return the text of a new task document, with the drawn values ``varied``.

    If ``own_scene`` is set, the task uses the scene cousin with the same index, and otherwise the twin's scene. The
    task inherits the twin's start conditions, except those for ``moved`` objects. A task with its own scene has no
    start regions because the twin's start regions are guaranteed to be free only in the twin's layout.
    """
    data = to_data(spec)
    if recipe.task_spec is not None:
        start = to_data(recipe.task_spec.start)
        start |= {key: {n: v for n, v in start.get(key, {}).items() if n not in moved} for key in ("place", "pose")}
        data |= {"start": {key: value for key, value in start.items() if value}} if any(start.values()) else {}
    data["name"] = named(recipe, index)
    data["scene"] = file_of(index, "scene") if own_scene else relative(recipe.scene.path, out)
    if own_scene:  # the start regions were computed for the twin's layout
        data.pop("reset", None)
    data["origin"] = {**data.get("origin", {}), **origin(recipe, index)}
    return write_tree(plain_tree(merged(data, varied)), TaskSpec)


def asset_overlay(recipe: Recipe, out: Path, index: int, asset: Path, varied: Mapping[str, Any]) -> str:
    """Return the text of an asset document that extends an asset and contains the drawn values ``varied``."""
    document = {"simfoundry": "asset/1", "extends": relative(asset, out), **varied, "origin": origin(recipe, index)}
    return write_tree(plain_tree(document), AssetSpec)


def _overlay(kind: str, recipe: Recipe, twin: Loaded, out: Path, index: int) -> Data:
    """Return the first entries of a document that extends a document of the twin."""
    return {"simfoundry": kind, "extends": relative(twin.path, out), "name": named(recipe, index)}


def named(recipe: Recipe, index: int) -> str:
    """Return the name of the cousin with the given index."""
    return f"{recipe.spec.name[:MOST_NAME]}_{index:06d}"


def origin(recipe: Recipe, index: int) -> Data:
    """Return the `origin` entry for a cousin's documents."""
    generator = f"simfoundry {simfoundry.__version__}"
    return {"cousin": {"recipe": recipe.spec.name, "seed": recipe.seed, "index": index, "generator": generator}}


def relative(file: Path, folder: Path) -> str:
    """Return the path to ``file`` as it is written in documents located in ``folder``."""
    return Path(os.path.relpath(file.resolve(), folder.resolve())).as_posix()
