"""Variant pools: the alternatives for each axis of a recipe (objects, distractors, tasks), found once for all
candidates.

Variants of objects are generated once per recipe, stored in a folder, and chosen for each cousin. Files that the
cousins need from outside the twin's project are copied to ``OUT/assets`` under content-based names.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from simfoundry.assets.cache import Cache, key_of
from simfoundry.cousins.objects.checks import Needs, needs_of
from simfoundry.cousins.objects.generation import SourceSetup, opened
from simfoundry.cousins.objects.item import ObjectAsset, item_of
from simfoundry.cousins.objects.retrieval import contents
from simfoundry.cousins.objects.variants import Origins, Progress, variants, write
from simfoundry.cousins.recipe.candidate import ImpossibleError, Reason
from simfoundry.cousins.recipe.document import Recipe, relative
from simfoundry.cousins.recipe.library import LibraryItem
from simfoundry.cousins.run.run import WORK
from simfoundry.errors import OutputError
from simfoundry.runtime.files import write_atomically
from simfoundry.scene.lower import lower
from simfoundry.spec.check.validate import validate
from simfoundry.spec.files import ASSET_SUFFIX, Loaded, located
from simfoundry.spec.load import load_kind
from simfoundry.spec.models.asset import AssetSpec
from simfoundry.spec.models.cousins import ObjectAxis, ObjectVariants
from simfoundry.spec.models.scene import SceneSpec
from simfoundry.spec.models.task import TaskSpec
from simfoundry.spec.yaml.nodes import YamlError
from simfoundry.spec.yaml.text import parse
from simfoundry.spec.yaml.tree import plain_tree
from simfoundry.spec.yaml.write import to_data, to_yaml, write_tree

if TYPE_CHECKING:
    from simfoundry.cousins.layout.twin import Twin
    from simfoundry.cousins.tasks.proposals import TaskCousin

VERSION = "variants/3"
"""Format version; incremented when the same twin, axis and seed would give other variants."""

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
    others, tasks = _choices(recipe, out, vlm), tasks_of(recipe, out, twin, vlm)
    most = None
    if recipe.spec.scene is None and recipe.spec.distractors is None:  # no layout varies
        most = math.prod(map(len, others.values())) * max(1, len(tasks))
    return VariantPool(others, references(recipe.distractors, recipe.scene.root, out), tasks, most)


def _choices(recipe: Recipe, out: Path, vlm: str) -> dict[str, tuple[Choice, ...]]:
    """Return the variants of each object that varies, generated once and written below ``OUT/assets/objects``.

    ``vlm`` names the model to query if the recipe names none.
    """
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
    found = {}
    for item in items:
        inside = item.file.resolve().is_relative_to(root)
        file = item.file if inside else copied(item.file, out / ASSETS / item.digest[:8] / item.name)
        found[item.name] = relative(file, out)
    return found


def copied(file: Path, folder: Path) -> Path:
    """Copy a mesh, or a flattened asset document, to ``folder`` with the files that it names."""
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
            target, data = folder / path.relative_to(beside), path.read_bytes()
            if not (target.is_file() and target.read_bytes() == data):
                write_atomically(target, data)


def tasks_of(recipe: Recipe, out: Path, twin: Twin, vlm: str = "") -> tuple[TaskCousin, ...]:
    """Return the tasks of a recipe by rank; empty if its tasks do not vary. ``vlm`` names a model to query.

    Raises :class:`ImpossibleError` if no task is possible in the twin.
    """
    from simfoundry.cousins.tasks.proposals import TaskCousin, task_cousins
    from simfoundry.robots.reach import hands_of

    axis, path = recipe.spec.task, out / WORK / "tasks.json"
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


# -- variants of objects -----------------------------------------------------------------------------------------------


def prepare(
    axis: ObjectAxis,
    scene: Loaded,
    tasks: Sequence[TaskSpec],
    seed: int,
    folder: Path,
    sources: Callable[[], Mapping[str, Origins]] | None = None,
    cache: Cache | None = None,
    progress: Progress | None = None,
    library: Path | None = None,
) -> dict[str, dict[str, Any]]:
    """Generate and write the variants of every object of an axis; variants already in the folder are reused.

    ``sources`` opens the sources other than rules, and is called only if something must be generated; ``library`` is
    the folder that one of them reads.

    Return the record of each object, which is also written beside the documents as ``NAME.variants.json``: the names of
    the ``accepted``, the ``refused`` with reasons, and what the twin itself ``lacks``.
    """
    assert isinstance(scene.spec, SceneSpec)
    lowered, records = None, {}
    origins: Mapping[str, Origins] | None = None
    for name, wanted in axis.objects.items():
        item = item_of(scene, name)
        lowered = lowered or lower(scene, cache)
        needs = needs_of(name, scene.spec, lowered, tasks)
        key = _key(item, wanted, needs, seed, axis, library)
        path = folder / f"{name}.variants.json"
        record = _read(path, key, folder)
        if record is None:
            origins = origins if origins is not None else sources() if sources is not None else {}
            made = variants(item, wanted, needs, seed, origins, cache, progress)
            for variant in made.accepted:
                write(variant, folder)
            record = {"key": key, **made.to_json()}
            write_atomically(path, (json.dumps(record, indent=1, ensure_ascii=False) + "\n").encode())
        records[name] = record
    return records


def made_for(
    axis: ObjectAxis, scene: Loaded, tasks: Sequence[TaskSpec], seed: int, folder: Path, given: SourceSetup
) -> dict[str, tuple[Path, ...]]:
    """Return the documents of each object's variants, generated if they do not exist yet.

    Raises :class:`ImpossibleError` for an object without variants (with the results of its candidates) and for a source
    that is not set up, and :class:`~simfoundry.errors.SimfoundryError` for models that do not answer.
    """
    cache, library = Cache.default(), given.library
    records = prepare(axis, scene, tasks, seed, folder, lambda: opened(axis, given, cache), cache, library=library)
    for name, record in records.items():
        if not record["accepted"]:
            tried = len(record["refused"])
            why = "; ".join(f"{count} times {code}" for code, count in record["reasons"].items())
            example = record["refused"][0]["reasons"][0]["text"] if tried else "there was no candidate"
            text = f"`{name}` has no variant among {tried} candidates: {why}; the first: {example}"
            raise ImpossibleError((Reason("variants", text, {"candidates": float(tried)}),))
    return {name: tuple(folder / one["asset"] for one in record["accepted"]) for name, record in records.items()}


@dataclass(frozen=True)
class VariantCount:
    """Number of variants of an object that were requested (``asked``) and ``made``, and of ``candidates`` examined.

    ``reasons`` counts each reason for rejection, ``examples`` has the text of the first of each.
    """

    name: str
    asked: int
    made: int
    candidates: int
    reasons: Mapping[str, int]
    examples: Mapping[str, str]

    @property
    def is_short(self) -> bool:
        """Return whether fewer variants were made than requested."""
        return self.made < self.asked

    def to_json(self) -> dict[str, Any]:
        """Return a plain mapping for manifests."""
        return {"asked": self.asked, "made": self.made, "candidates": self.candidates, "reasons": dict(self.reasons)}

    def __str__(self) -> str:
        text = f"variants of `{self.name}`: {self.made} of {self.asked} made from {self.candidates} candidates"
        if not self.reasons:
            return text
        rest = "; ".join(f"{count} refused: {code}" for code, count in self.reasons.items())
        code = next(iter(self.reasons))
        return f"{text}; {rest} (such as: {self.examples[code]})" if self.is_short else f"{text}; {rest}"


def counts(axis: ObjectAxis | None, folder: Path) -> tuple[VariantCount, ...]:
    """Return the counts of each object of an axis, from the records in the folder of its variants."""
    found = []
    for name, wanted in axis.objects.items() if axis is not None else ():
        record = json.loads((folder / f"{name}.variants.json").read_bytes())
        examples: dict[str, str] = {}
        for reason in (reason for one in record["refused"] for reason in one["reasons"]):
            examples.setdefault(reason["code"], reason["text"])
        made, refused = len(record["accepted"]), len(record["refused"])
        found.append(VariantCount(name, wanted.count, made, made + refused, record["reasons"], examples))
    return tuple(found)


def _key(
    item: ObjectAsset, wanted: ObjectVariants, needs: Needs, seed: int, axis: ObjectAxis, library: Path | None
) -> str:
    """Return the cache key of an object's variants.

    Models enter by their names in the recipe, because their answers differ from call to call.
    """
    meshes = [path.read_bytes() for _, path in sorted(item.files.items())]
    calls = json.dumps([[str(c) for c in needs.rests], list(needs.joints), needs.opening])
    of = [axis.models.model_dump_json()] if "model" in wanted.sources else []
    of += [json.dumps(contents(library))] if "library" in wanted.sources and library is not None else []
    said = (item.name, item.category, to_yaml(item.spec), wanted.model_dump_json(), calls, str(seed), *of)
    return key_of(VERSION, *said, *meshes)


def _read(path: Path, key: str, folder: Path) -> dict[str, Any] | None:
    """Read the record of variants generated earlier with the same key, if all of their files still exist."""
    try:
        record = json.loads(path.read_bytes())
        whole = record["key"] == key and all((folder / one["asset"]).is_file() for one in record["accepted"])
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return record if whole else None
