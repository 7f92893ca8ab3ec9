"""Variant pools: the alternatives for each axis of a recipe (objects, distractors, tasks), found once for all
candidates.

Files that the cousins need from outside the twin's project are copied to ``OUT/assets`` under content-based names.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from simfoundry.cousins.recipe.document import Recipe
from simfoundry.cousins.recipe.library import LibraryItem
from simfoundry.cousins.recipe.overlay import relative
from simfoundry.cousins.run.log import WORK
from simfoundry.errors import OutputError
from simfoundry.runtime.files import write_atomically
from simfoundry.spec.check.validate import validate
from simfoundry.spec.files import ASSET_SUFFIX, located
from simfoundry.spec.models.task import TaskSpec
from simfoundry.spec.yaml.nodes import YamlError
from simfoundry.spec.yaml.text import parse
from simfoundry.spec.yaml.write import to_yaml

if TYPE_CHECKING:
    from simfoundry.cousins.layout.twin import Twin
    from simfoundry.cousins.tasks.proposals import TaskCousin

ASSETS = "assets"
"""Folder below the output for copied assets."""


@dataclass(frozen=True)
class Choice:
    """A replacement for an object: its document, and the path by which cousins name it."""

    file: Path
    reference: str


@dataclass(frozen=True)
class VariantPool:
    """``choices`` by object, ``references`` of distractors by name, and ``tasks``; empty for axes that do not vary.

    ``most`` is the number of distinct candidates, None if it is unbounded.
    """

    choices: Mapping[str, tuple[Choice, ...]] = field(default_factory=lambda: MappingProxyType({}))
    references: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))
    tasks: tuple[TaskCousin, ...] = ()
    most: int | None = None

    def combination(self, k: int) -> dict[str, Choice]:
        """Return combination ``k`` of choices, counted from 0; none is repeated before all have occurred."""
        found = {}
        for name, of in self.choices.items():
            k, digit = divmod(k, len(of))
            found[name] = of[digit]
        return found


def variant_pool(recipe: Recipe, out: Path, twin: Twin, vlm: str = "") -> VariantPool:
    """Collect the alternatives for each axis; raises :class:`ImpossibleError` if an axis has none."""
    from simfoundry.cousins.recipe.variant_pool import tasks_of

    others, tasks = choices(recipe, out, vlm), tasks_of(recipe, out, twin, vlm)
    most = None
    if recipe.spec.scene is None and recipe.spec.distractors is None:  # no layout varies
        most = math.prod(map(len, others.values())) * max(1, len(tasks))
    return VariantPool(others, references(recipe.distractors, recipe.scene.root, out), tasks, most)


def choices(recipe: Recipe, out: Path, vlm: str = "") -> dict[str, tuple[Choice, ...]]:
    """Return the variants of each object that varies, generated once and written below ``OUT/assets/objects``.

    ``vlm`` names the model to query if the recipe names none.
    """
    from simfoundry.cousins.objects.generation import SourceSetup
    from simfoundry.cousins.objects.swap import made_for

    axis, folder = recipe.spec.object, out / ASSETS / "objects"
    if axis is None:
        return {}
    library = None if axis.library is None else located(axis.library, recipe.loaded.path)
    tasks = [] if recipe.task_spec is None else [recipe.task_spec]
    files = made_for(axis, recipe.scene, tasks, recipe.seed, folder, SourceSetup(recipe.scene.path, library, vlm))
    return {name: tuple(Choice(file, relative(file, out)) for file in of) for name, of in files.items()}


def references(items: Iterable[LibraryItem], root: Path, out: Path) -> dict[str, str]:
    """Return the paths by which cousins in ``out`` name library objects; files outside the project ``root`` are copied
    first.
    """
    return {item.name: _reference(item, root, out) for item in items}


def _reference(item: LibraryItem, root: Path, out: Path) -> str:
    if item.file.resolve().is_relative_to(root):
        return relative(item.file, out)
    return relative(copied(item.file, out / ASSETS / item.digest[:8] / item.name), out)


def copied(file: Path, folder: Path) -> Path:
    """Copy a mesh, or a flattened asset document, to ``folder`` with the files that it names."""
    from simfoundry.spec.load import load_kind
    from simfoundry.spec.models.asset import AssetSpec
    from simfoundry.spec.yaml.tree import plain_tree
    from simfoundry.spec.yaml.write import to_data, write_tree

    if not file.name.endswith(ASSET_SUFFIX):
        _copy_mesh(file, folder)
        return folder / file.name
    loaded = load_kind(file, "asset/1")
    assert isinstance(loaded.spec, AssetSpec)
    meshes = {p.mesh for link in loaded.spec.links.values() for p in link.parts.values() if p.mesh is not None}
    names = {mesh: f"{k}/{Path(mesh).name}" for k, mesh in enumerate(sorted(meshes))}
    for mesh, name in names.items():
        _copy_mesh(loaded.file(mesh), (folder / name).parent)
    data = to_data(loaded.spec)
    data.pop("extends", None)
    for link in data["links"].values():
        for part in link.get("parts", {}).values():
            if "mesh" in part:
                part["mesh"] = names[part["mesh"]]
    write_atomically(folder / file.name, write_tree(plain_tree(data), AssetSpec).encode())
    return folder / file.name


def _copy_mesh(mesh: Path, folder: Path) -> None:
    """Copy a mesh with those of its materials and textures that are in its folder."""
    from simfoundry.scene.robot_files import companions

    beside = mesh.parent.resolve()
    for path in (mesh.resolve(), *companions(mesh)):
        if path.is_relative_to(beside):
            _copy(path, folder / path.relative_to(beside))


def _copy(source: Path, target: Path) -> None:
    data = source.read_bytes()
    if not (target.is_file() and target.read_bytes() == data):
        write_atomically(target, data)


FILE = "tasks.json"


def tasks_of(recipe: Recipe, out: Path, twin: Twin, vlm: str = "") -> tuple[TaskCousin, ...]:
    """Return the tasks of a recipe by rank; empty if its tasks do not vary. ``vlm`` names a model to query.

    Raises :class:`ImpossibleError` if no task is possible in the twin.
    """
    from simfoundry.cousins.tasks.proposals import TaskCousin, task_cousins
    from simfoundry.robots.reach import hands_of

    axis, path = recipe.spec.task, out / WORK / FILE
    if axis is None:
        return ()
    if not path.is_file():
        asked: dict[str, Any] = {}
        if axis.proposals == "model" and vlm:
            from simfoundry.cousins.run.report import draw
            from simfoundry.models.vlm import Vlm

            asked = {"vlm": Vlm(vlm), "picture": draw(recipe.scene.path) or b""}
        reference = relative(recipe.scene.path, out)
        found, _ = task_cousins(twin, recipe.scene_spec, axis, recipe.seed, reference, **asked)
        rows = [{"task": to_yaml(one.spec), "goal": one.goal} for one in found]
        write_atomically(path, (json.dumps(rows, indent=1, ensure_ascii=False) + "\n").encode())
    hands = hands_of(recipe.scene_spec.robots)
    kept = json.loads(path.read_text())
    return tuple(TaskCousin(_task(one["task"], path), one["goal"], hands, axis.engines) for one in kept)


def _task(text: str, path: Path) -> TaskSpec:
    """Parse a stored task; raises :class:`OutputError` if it has been edited into an invalid one."""
    try:
        spec, _ = validate(TaskSpec, parse(text))
    except YamlError:
        spec = None
    if spec is None:
        raise OutputError(f"{path} is damaged; remove it to generate the tasks again")
    return spec
