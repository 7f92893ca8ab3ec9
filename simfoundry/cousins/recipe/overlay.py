"""Cousins as overlay documents: a reference to the twin, and only the fields that differ."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path
from typing import Any

import simfoundry
from simfoundry.cousins.recipe.candidate import file_of
from simfoundry.cousins.recipe.document import Recipe
from simfoundry.geometry.frames import Pose
from simfoundry.scene.model import Scene
from simfoundry.scene.state import SceneState, pose, pose_spec
from simfoundry.spec.models.place import DEPTHS, SIDES, Place
from simfoundry.spec.models.scene import SceneSpec
from simfoundry.spec.models.task import TaskSpec
from simfoundry.spec.yaml.tree import plain_tree
from simfoundry.spec.yaml.write import to_data, write_tree

STILL = 1e-3
"""Joint displacement [m or rad] while settling below which the written position is kept."""

MOST_NAME = 57
"""Maximum length of a recipe's name in the names of its cousins, to which six digits are appended."""

Data = dict[str, Any]


def scene_overlay(
    recipe: Recipe,
    out: Path,
    index: int,
    changes: Mapping[str, Data],
    poses: Mapping[str, Pose],
    joints: Mapping[str, Mapping[str, float]],
    relations: tuple[str, ...],
) -> str:
    """Return the text of a scene that extends the twin's.

    ``changes`` are other fields of objects by name, including new objects; ``poses`` X_WO are written for the objects
    they name, ``joints`` [m or rad] for those that moved; ``relations`` are all that hold.
    """
    objects: dict[str, Data] = {}
    for name in (*recipe.scene_spec.objects, *(n for n in changes if n not in recipe.scene_spec.objects)):
        data = dict(changes.get(name, {}))
        if name in poses:
            data["pose"] = to_data(pose_spec(poses[name]))
        if joints.get(name):
            data["joints"] = dict(joints[name])
        if data:
            objects[name] = data
    document: Data = {
        "simfoundry": "scene/1",
        "extends": relative(recipe.scene.path, out),
        "name": named(recipe, index),
    }
    document |= {"objects": objects} if objects else {}
    document |= {"relations": relations} if relations != recipe.scene_spec.relations else {}
    document["origin"] = origin(recipe, index)
    return write_tree(plain_tree(document), SceneSpec)


def task_overlay(recipe: Recipe, out: Path, index: int, moved: Collection[str], crowded: bool) -> str:
    """Return the text of a task that extends the twin's, in a scene cousin in which ``moved`` objects have other poses.

    Start conditions of the twin about moved objects are removed. So are its start regions if objects moved or the scene
    is ``crowded`` with more objects, because the regions were free of the twin's objects only. Rollouts start from the
    scene's layout.
    """
    assert recipe.task is not None and recipe.task_spec is not None
    spec = recipe.task_spec
    document: Data = {
        "simfoundry": "task/1",
        "extends": relative(recipe.task.path, out),
        "name": named(recipe, index),
        "scene": file_of(index, "scene"),
    }
    gone = {key: {name: None for name in getattr(spec.start, key) if name in moved} for key in ("place", "pose")}
    start = {key: names for key, names in gone.items() if names}
    document |= {"start": start} if start else {}
    if spec.reset.objects and (crowded or set(spec.reset.objects) & set(moved)):
        document["reset"] = None
    document["origin"] = origin(recipe, index)
    return write_tree(plain_tree(document), TaskSpec)


def own_task(recipe: Recipe, out: Path, index: int, spec: TaskSpec, moved: Collection[str], own_scene: bool) -> str:
    """Return the text of a new task, in the scene cousin of the same index or in the twin's scene.

    The task starts like the twin, except for ``moved`` objects. In a scene of its own it starts from that scene's
    layout, because the twin's start regions were free of the twin's objects only.
    """
    data = to_data(spec)
    if own_scene:
        data.pop("reset", None)
    if recipe.task_spec is not None:
        start = to_data(recipe.task_spec.start)
        kept = {key: {n: v for n, v in start.get(key, {}).items() if n not in moved} for key in ("place", "pose")}
        start |= kept
        data |= {"start": {key: value for key, value in start.items() if value}} if any(start.values()) else {}
    data["name"] = named(recipe, index)
    data["scene"] = file_of(index, "scene") if own_scene else relative(recipe.scene.path, out)
    if own_scene:  # start regions were found in the twin's layout
        data.pop("reset", None)
    data["origin"] = {**data.get("origin", {}), **origin(recipe, index)}
    return write_tree(plain_tree(data), TaskSpec)


def named(recipe: Recipe, index: int) -> str:
    """Return the name of a cousin."""
    return f"{recipe.spec.name[:MOST_NAME]}_{index:06d}"


def origin(recipe: Recipe, index: int) -> Data:
    """Return the origin entry of a cousin."""
    generator = f"simfoundry {simfoundry.__version__}"
    return {"cousin": {"recipe": recipe.spec.name, "seed": recipe.seed, "index": index, "generator": generator}}


def relative(file: Path, folder: Path) -> str:
    """Return the path by which documents in a folder name a file."""
    return Path(os.path.relpath(file.resolve(), folder.resolve())).as_posix()


def written(poses: Mapping[str, Pose]) -> dict[str, Pose]:
    """Round poses to the precision of documents, 0.1 mm and 0.01 deg."""
    return {name: pose(pose_spec(X_WO)) for name, X_WO in poses.items()}


def dependents(spec: SceneSpec, moved: Iterable[str]) -> set[str]:
    """Objects whose documents place them, directly or indirectly, on, in or beside moved objects."""
    places = {name: item.place for name, item in spec.objects.items() if item.place is not None}
    found, todo = set[str](), set(moved)
    while todo:
        more = {name for name, place in places.items() if named_by(place) & todo} - found
        found |= more
        todo = more
    return found


def named_by(place: Place) -> set[str]:
    """Names of the objects that a place refers to."""
    keys = ("on", "inside", *SIDES, *DEPTHS)
    return {str(getattr(place, key)).partition(".")[0] for key in keys if getattr(place, key) is not None}


def moved_joints(scene: Scene, state: SceneState, names: Iterable[str]) -> dict[str, dict[str, float]]:
    """Single-axis joints that differ from their positions in the scene, by object and joint."""
    found: dict[str, dict[str, float]] = {}
    for name in names:
        for joint in scene.object(name).joints:
            at = state.joints.get(f"{name}.{joint.name}", joint.position)
            if joint.mimic is None and joint.has_axis and abs(at - joint.position) > STILL:
                low, high = joint.limits or (at, at)  # engines enforce limits softly
                found.setdefault(name, {})[joint.name] = round(min(max(at, low), high), 4) + 0.0
    return found
