"""Collect the alternatives for each axis of a recipe (objects, distractors, tasks) in a variant pool.

The pool is created once and shared by all candidates. Object variants are generated once per recipe and stored in a
folder, from which each cousin chooses. If cousins need files from outside the twin's project, these are copied to
``OUT/assets`` under names that are derived from their content.
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
from simfoundry.cousins.run.log import WORK
from simfoundry.errors import OutputError
from simfoundry.models.contract import ModelError
from simfoundry.models.provenance import require_commercial, used_identity
from simfoundry.models.setup import ModelSetup
from simfoundry.runtime.files import write_atomically
from simfoundry.scene.frames import FrameTree
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

# Version of the generated variants; increment it when the same twin, axis and seed produce different variants.
VERSION = "variants/3"

# Subfolder of the output folder for copied assets.
ASSETS = "assets"


@dataclass(frozen=True)
class Choice:
    """A replacement for an object, given by its document and the path to it as written in cousins."""

    file: Path
    reference: str


@dataclass(frozen=True)
class VariantPool:
    """The alternatives for each axis of a recipe.

    Attributes:
        choices: Replacements for each object that varies.
        references: Path to each distractor as written in cousins, keyed by distractor name.
        tasks: Tasks to choose from. There are none if the task does not vary.
        most: Number of distinct candidates, or None if it is unbounded.
    """

    choices: Mapping[str, tuple[Choice, ...]] = field(default_factory=lambda: MappingProxyType({}))
    references: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))
    tasks: tuple[TaskCousin, ...] = ()
    most: int | None = None

    def combination(self, k: int) -> dict[str, Choice]:
        """Return combination ``k`` of the choices, counted from 0.

        No combination repeats until all combinations have occurred.
        """
        found = {}
        for name, of in self.choices.items():
            k, digit = divmod(k, len(of))
            found[name] = of[digit]
        return found


def variant_pool(recipe: Recipe, out: Path, twin: Twin, vlm: str = "", commercial_only: bool = False) -> VariantPool:
    """Collect the alternatives for each axis. The last two arguments are those of :class:`SourceSetup`.

    Raises:
        ImpossibleError: An axis has no alternatives.
    """
    others = _choices(recipe, out, vlm, commercial_only)
    tasks = tasks_of(recipe, out, twin, vlm, commercial_only)
    same_layout = recipe.spec.scene is None and recipe.spec.distractors is None and not recipe.spec.vary
    most = math.prod(map(len, others.values())) * max(1, len(tasks)) if same_layout else None
    return VariantPool(others, references(recipe.distractors, recipe.scene.root, out), tasks, most)


def _choices(recipe: Recipe, out: Path, vlm: str, commercial_only: bool) -> dict[str, tuple[Choice, ...]]:
    """Return the variants of each object that varies.

    The variants are generated once and stored in ``OUT/assets/objects``. ``vlm`` is the name of the model to query if
    the recipe does not specify one.
    """
    axis, folder = recipe.spec.object, out / ASSETS / "objects"
    if axis is None:
        return {}
    library = None if axis.library is None else located(axis.library, recipe.loaded.path)
    tasks = [] if recipe.task_spec is None else [recipe.task_spec]
    given = SourceSetup(recipe.scene.path, library, vlm, commercial_only)
    files = made_for(axis, recipe.scene, tasks, recipe.seed, folder, given)
    return {name: tuple(Choice(file, relative(file, out)) for file in of) for name, of in files.items()}


def references(items: Iterable[LibraryItem], root: Path, out: Path) -> dict[str, str]:
    """Return the paths to library objects, as written in cousins that are located in ``out``.

    Files outside the project folder ``root`` are copied to the output folder first.
    """

    def local(item: LibraryItem) -> Path:
        inside = item.file.resolve().is_relative_to(root)
        return item.file if inside else copied(item.file, out / ASSETS / item.digest[:8] / item.name)

    return {item.name: relative(local(item), out) for item in items}


def copied(file: Path, folder: Path) -> Path:
    """Copy a mesh or a flattened asset document to ``folder``, along with the files to which it refers."""
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
    for part in (part for link in data["links"].values() for part in link.get("parts", {}).values()):
        part |= {"mesh": names[part["mesh"]]} if "mesh" in part else {}
    write_atomically(folder / file.name, write_tree(plain_tree(data), AssetSpec).encode())
    return folder / file.name


def _copy_mesh(mesh: Path, folder: Path) -> None:
    """Copy a mesh along with all materials and textures in the same folder and its subfolders."""
    from simfoundry.scene.robot_files import companions

    beside = mesh.parent.resolve()
    for path in (mesh.resolve(), *companions(mesh)):
        if path.is_relative_to(beside):
            target, data = folder / path.relative_to(beside), path.read_bytes()
            if not (target.is_file() and target.read_bytes() == data):
                write_atomically(target, data)


def tasks_of(
    recipe: Recipe, out: Path, twin: Twin, vlm: str = "", commercial_only: bool = False
) -> tuple[TaskCousin, ...]:
    """Return the tasks of a recipe in order of rank, or an empty tuple if the task does not vary.

    Args:
        recipe: The recipe.
        out: Output folder, in which the tasks are stored for later calls.
        twin: The twin in which the tasks must be possible.
        vlm: Name of the model to query, if the recipe uses a model.
        commercial_only: Whether to refuse models that may not be used commercially.

    Raises:
        ImpossibleError: If no task is possible in the twin.
        ModelError: If the model may not be used.
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
            from simfoundry.models.open import open_vlm

            setup = SourceSetup(recipe.scene.path, commercial_only=commercial_only).models
            asked = {"vlm": open_vlm(setup, vlm), "picture": draw(recipe.scene.path) or b""}
        reference = relative(recipe.scene.path, out)
        found, _ = task_cousins(twin, recipe.scene_spec, axis, recipe.seed, reference, **asked)
        rows = [{"task": to_yaml(one.spec), "goal": one.goal} for one in found]
        write_atomically(path, (json.dumps(rows, indent=1, ensure_ascii=False) + "\n").encode())
    hands = hands_of(recipe.scene_spec.robots, FrameTree(recipe.scene_spec))
    kept = json.loads(path.read_text())
    return tuple(TaskCousin(_task(one["task"], path), one["goal"], hands, axis.engines) for one in kept)


def _task(text: str, path: Path) -> TaskSpec:
    """Parse a stored task.

    Raises:
        OutputError: The task was edited and is no longer valid.
    """
    try:
        spec, _ = validate(TaskSpec, parse(text))
    except YamlError:
        spec = None
    if spec is None:
        raise OutputError(f"{path} is damaged; delete it to generate the tasks again")
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
    """Generate and write the variants of every object in an axis, reusing variants that already exist in the folder.

    Args:
        axis: The axis that lists the objects to vary.
        scene: Document of the twin's scene.
        tasks: Tasks that the variants must support.
        seed: Seed for the random number generator.
        folder: Folder to which the variants are written.
        sources: Function that opens the sources other than rules. It is called only if variants must be generated.
        cache: Cache for lowered objects.
        progress: Callback that receives the number of variants and the number of candidates examined.
        library: Folder of the library source, if one is used.

    Returns:
        A record for each object, which is also written to ``NAME.variants.json`` in ``folder``. The record lists the
        ``accepted`` variants and the ``refused`` candidates with reasons. Under ``lacks``, it lists the requirements
        that the twin itself does not meet.
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
            if origins is None:
                origins = sources() if sources is not None else {}
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
    """Return the paths of each object's variant documents, and generate the variants if they do not exist yet.

    Raises:
        ImpossibleError: If all candidates for an object were rejected, or if a source is not configured.
        SimfoundryError: If a model does not respond, or if a variant comes from one that may not be used.
    """
    cache, library = Cache.default(), given.library
    records = prepare(axis, scene, tasks, seed, folder, lambda: opened(axis, given, cache), cache, library=library)
    for name, record in records.items():
        if not record["accepted"]:
            tried = len(record["refused"])
            why = "; ".join(f"{code} ({count} times)" for code, count in record["reasons"].items())
            example = record["refused"][0]["reasons"][0]["text"] if tried else "there was no candidate"
            text = f"all {tried} candidates for variants of `{name}` were rejected: {why}; for example: {example}"
            raise ImpossibleError((Reason("variants", text, {"candidates": float(tried)}),))
    files = {name: tuple(folder / one["asset"] for one in record["accepted"]) for name, record in records.items()}
    by_models = [one["asset"] for record in records.values() for one in record["accepted"] if one["source"] == "model"]
    if by_models:
        _require_permitted([folder / name for name in by_models], given.models)
    return files


def _require_permitted(files: Iterable[Path], setup: ModelSetup) -> None:
    """Check that earlier runs made no variant with a model that may not be used now.

    Raises:
        ModelError: If one did. The message names the variant.
    """
    for file in files if setup.commercial_only else ():
        spec = load_kind(file, "asset/1").spec
        assert isinstance(spec, AssetSpec)
        for use in spec.origin.models if spec.origin is not None else ():
            try:
                require_commercial(used_identity(use), setup.accepted)
            except ModelError as error:
                raise ModelError(f"{file} was made earlier with a model that is refused now: {error}") from None


@dataclass(frozen=True)
class VariantCount:
    """The variant counts for an object.

    Attributes:
        name: Name of the object.
        asked: Number of variants requested.
        made: Number of variants generated.
        candidates: Number of candidates examined.
        reasons: Number of rejections by reason code.
        examples: Message of the first rejection by reason code.
    """

    name: str
    asked: int
    made: int
    candidates: int
    reasons: Mapping[str, int]
    examples: Mapping[str, str]

    @property
    def is_short(self) -> bool:
        """True if fewer variants were generated than requested."""
        return self.made < self.asked

    def to_json(self) -> dict[str, Any]:
        """Return the counts as plain data for manifests."""
        return {"asked": self.asked, "made": self.made, "candidates": self.candidates, "reasons": dict(self.reasons)}

    def __str__(self) -> str:
        text = f"variants of `{self.name}`: {self.made} of {self.asked} generated from {self.candidates} candidates"
        if not self.reasons:
            return text
        rest = "; ".join(f"{count} rejected: {code}" for code, count in self.reasons.items())
        code = next(iter(self.reasons))
        return f"{text}; {rest} (for example: {self.examples[code]})" if self.is_short else f"{text}; {rest}"


def counts(axis: ObjectAxis | None, folder: Path) -> tuple[VariantCount, ...]:
    """Return the variant counts for each object in an axis, based on the records in the variants folder."""
    found = []
    for name, wanted in axis.objects.items() if axis is not None else ():
        record = json.loads((folder / f"{name}.variants.json").read_bytes())
        reasons = [reason for one in record["refused"] for reason in one["reasons"]]
        examples = {reason["code"]: reason["text"] for reason in reversed(reasons)}
        made, refused = len(record["accepted"]), len(record["refused"])
        found.append(VariantCount(name, wanted.count, made, made + refused, record["reasons"], examples))
    return tuple(found)


def _key(
    item: ObjectAsset, wanted: ObjectVariants, needs: Needs, seed: int, axis: ObjectAxis, library: Path | None
) -> str:
    """Return the cache key for an object's variants.

    For models, the key depends only on their names in the recipe because responses differ from call to call.
    """
    meshes = [path.read_bytes() for _, path in sorted(item.files.items())]
    calls = json.dumps([[str(c) for c in needs.rests], list(needs.joints), needs.opening])
    of = [axis.models.model_dump_json()] if "model" in wanted.sources else []
    of += [json.dumps(contents(library))] if "library" in wanted.sources and library is not None else []
    said = (item.name, item.category, to_yaml(item.spec), wanted.model_dump_json(), calls, str(seed), *of)
    return key_of(VERSION, *said, *meshes)


def _read(path: Path, key: str, folder: Path) -> dict[str, Any] | None:
    """Read the record of previously generated variants.

    Returns:
        The record, or None if it has a different key or if a variant's file no longer exists.
    """
    try:
        record = json.loads(path.read_bytes())
        whole = record["key"] == key and all((folder / one["asset"]).is_file() for one in record["accepted"])
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return record if whole else None
