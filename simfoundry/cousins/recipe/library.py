"""Distractor libraries: folders of assets and meshes, with the measured mass, volume and density of each object.

An object's mass is the mass of the lowered asset. Its volume is the total volume of its convex parts. For a cup, for
example, this is the volume of the wall. Both are measured once and cached.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

from simfoundry.assets.cache import Cache, key_of
from simfoundry.cousins.objects.appearance import category_prior, same_kind
from simfoundry.cousins.objects.retrieval import likeness
from simfoundry.cousins.recipe.candidate import ImpossibleError, Reason, free_name
from simfoundry.errors import SimfoundryError
from simfoundry.runtime.files import shipped
from simfoundry.scene.model import SceneObject
from simfoundry.spec.diagnostics import SpecError, nearest
from simfoundry.spec.files import ASSET_SUFFIX, MESH_SUFFIXES, Loaded
from simfoundry.spec.load import load
from simfoundry.spec.models.cousins import DistractorAxis, ValueRange

# Version of the measured data; part of the cache key.
VERSION = "library facts 2"

# Assumed density [kg/m^3] of meshes, whose files do not specify a mass. Solid household objects are about as dense as
# water, and hollow ones float.
MESH_DENSITY = {"value": 500, "range": (100, 1500), "source": "library"}

# Generic file name stems that are ignored; the object is named after its folder instead.
_NAMELESS = {"textured", "nontextured", "model", "mesh", "visual", "collision", "object", "base", "tsdf", "poisson"}


@dataclass(frozen=True)
class LibraryItem:
    """An object in a library.

    Attributes:
        name: Unique name in the library.
        category: Category, taken from the asset document or derived from the file name.
        file: Asset document or mesh file.
        mass: Mass [kg].
        volume: Total volume of the convex parts [m^3].
        size: Extents of the bounding box [m].
        digest: Hash of the content.
        stated: True if the asset document specifies the category, False if the category is derived.
    """

    name: str
    category: str
    file: Path
    mass: float
    volume: float
    size: tuple[float, float, float]
    digest: str
    stated: bool = True

    @property
    def density(self) -> float:
        """The mass divided by the volume [kg/m^3], or 0 if the volume is 0."""
        return self.mass / self.volume if self.volume > 0 else 0.0

    def data(self, reference: str) -> dict[str, Any]:
        """Return the object's entry for a scene document.

        ``reference`` is the path to the object's file, as written in that document.
        """
        data: dict[str, Any] = {"asset": reference}
        if not reference.endswith(ASSET_SUFFIX):
            data |= {"density": dict(MESH_DENSITY), "category": self.category}
        return data


@dataclass(frozen=True)
class Library:
    """The objects in a folder.

    ``faults`` contains the relative path of each unusable file and the reason why it was skipped.
    """

    title: str
    items: tuple[LibraryItem, ...]
    faults: tuple[tuple[str, str], ...] = ()


def default_folder() -> Path:
    """Return the folder of assets that are shipped with SimFoundry."""
    return shipped("specs/assets")


def read_library(folder: Path, cache: Cache | None = None) -> Library:
    """Read all objects in a folder and its subfolders.

    The objects are all asset documents, plus all meshes to which no asset document refers.

    Raises:
        SimfoundryError: If the folder does not exist.
    """
    if not folder.is_dir():
        raise SimfoundryError(
            f"the library folder {folder} does not exist; specify a folder of .asset.yaml documents or meshes"
        )
    items: dict[str, LibraryItem] = {}
    faults = []
    for file in _files(folder):
        try:
            _add(items, measured(file, cache or Cache.default()))
        except (SpecError, SimfoundryError) as error:
            why = error.diagnostics[0].message if isinstance(error, SpecError) else str(error)
            faults.append((file.relative_to(folder).as_posix(), why))
    return Library(folder.name, tuple(items.values()), tuple(faults))


def _add(items: dict[str, LibraryItem], item: LibraryItem) -> None:
    name = free_name(item.name, items)
    items[name] = replace(item, name=name)


def united(libraries: Sequence[Library]) -> Library:
    """Merge several libraries, preserving their order and dropping duplicates."""
    items: dict[str, LibraryItem] = {}
    digests = set[str]()
    for item in (item for of in libraries for item in of.items):
        if item.digest not in digests:
            _add(items, item)
            digests.add(item.digest)
    title = " and ".join(of.title for of in libraries)
    return Library(title, tuple(items.values()), tuple(fault for of in libraries for fault in of.faults))


def _files(folder: Path) -> Iterator[Path]:
    every = [p for p in sorted(folder.rglob("*")) if p.is_file() and not p.name.startswith(".")]
    documents = [p for p in every if p.name.endswith(ASSET_SUFFIX)]
    named = {p for document in documents for p in _meshes_of(document)}
    yield from documents
    yield from (p for p in every if p.suffix.lower() in MESH_SUFFIXES and p.resolve() not in named)


def _meshes_of(document: Path) -> list[Path]:
    from simfoundry.spec.models.asset import AssetSpec

    loaded = load(document)
    if not isinstance(loaded.spec, AssetSpec):
        return []
    parts = (part for link in loaded.spec.links.values() for part in link.parts.values())
    return [loaded.file(part.mesh).resolve() for part in parts if part.mesh is not None]


def name_of(file: Path) -> str:
    """Derive an object name from a file path: ``025_mug/textured.obj`` becomes ``mug``."""
    stem = file.name.split(".")[0]
    if stem.lower() in _NAMELESS or stem.lower().startswith("google"):
        stem = next((p.name for p in file.parents if p.name.lower() not in _NAMELESS and p.name != "google_16k"), stem)
    word = re.sub(r"[^a-z0-9]+", "_", stem.lower()).strip("_0123456789")
    return word[:48].rstrip("_") or "thing"


def described(file: Path) -> Loaded:
    """Return a scene document that contains only the object defined in ``file`` and that is in the same folder."""
    name = name_of(file)
    text = f"simfoundry: scene/1\nname: library\nobjects:\n  {name}: {{asset: {json.dumps(file.name)}}}\n"
    if not file.name.endswith(ASSET_SUFFIX):
        density = f"{{value: {MESH_DENSITY['value']}, range: [100, 1500], source: library}}"
        text = text.replace("}\n", f", density: {density}, category: {name}}}\n")
    return load(file.parent / "library.scene.yaml", text=text)


@lru_cache(maxsize=1024)
def lowered(file: Path) -> SceneObject:
    """Lower the object in a file, with its frame at the origin.

    Results are cached because many scenes share an object.

    Raises:
        SpecError: The object is invalid.
    """
    from simfoundry.scene.lower import lower

    return lower(described(file), Cache.default()).objects[0]


def measured(file: Path, cache: Cache) -> LibraryItem:
    """Measure the object in a file, or read the measurements from the cache.

    Raises:
        SpecError: The object is invalid.
    """
    from simfoundry.targets.inputs import record

    loaded = described(file)
    if loaded.errors:
        raise SpecError(loaded.errors)
    inputs = record(loaded, ())
    digest = key_of(VERSION, *(inputs[key][name] for key in ("documents", "files") for name in inputs[key]))
    key = key_of(digest, json.dumps(inputs["software"], sort_keys=True))
    stored = cache.get(key)
    facts = _read(stored) if stored is not None else None
    if facts is None:
        asset = loaded.used(file.name)  # None for a mesh, which does not specify a category
        stated = asset is not None and getattr(asset.spec, "category", None) is not None
        facts = {**measure(lowered(file)), "stated": stated}
        cache.put(key, json.dumps(facts).encode())
    size, stated = tuple(facts["size"]), facts["stated"]
    return LibraryItem(name_of(file), facts["category"], file, facts["mass"], facts["volume"], size, digest, stated)


def _read(stored: bytes) -> dict[str, Any] | None:
    try:
        data = json.loads(stored)
        return data if {"category", "mass", "volume", "size", "stated"} <= data.keys() else None
    except (ValueError, AttributeError):
        return None


def measure(item: SceneObject) -> dict[str, Any]:
    """Return an object's category, mass, volume and size.

    The mass is in kg. The volume of the convex parts is in m^3. The extents of the bounding box are in m.
    """
    from simfoundry.scene.object_shapes import bounds

    low, high = bounds(item)
    return {
        "category": item.category,
        "mass": float(sum(link.mass for link in item.links)),
        "volume": float(sum(volume(c.geometry) for link in item.links for c in link.colliders)),
        "size": [float(v) for v in high - low],
    }


def volume(geometry: Any) -> float:
    """Return the volume of a primitive or closed mesh [m^3]."""
    from simfoundry.assets import mass
    from simfoundry.geometry.shapes import Box, Capsule, Cylinder, Mesh, Sphere

    match geometry:
        case Box(size):
            return mass.box(size).volume
        case Sphere(radius):
            return mass.sphere(radius).volume
        case Cylinder(radius, height):
            return mass.cylinder(radius, height).volume
        case Capsule(radius, height):
            return mass.capsule(radius, height).volume
        case Mesh(vertices, faces):
            return abs(float(mass.mesh(vertices, faces).volume))
    raise TypeError(f"unknown geometry: {geometry!r}")


KIND_OF_TWIN = "a category that the twin does not have"
# Phrases that describe two of the filters in messages.
SHAPE_OF_TWIN = "a category, or a shape that the twin does not have"

# Similarity thresholds for objects that are identified by neither a category nor their name: the maximum ratio of side
# lengths and the maximum shape distance (see :class:`LikenessDistance`). Among the shipped objects, the shape distance
# is 0.05 between a cup and a mug, and 0.08 between a pot and a bowl.
LIKE_SIZE, LIKE_SHAPE = 1.3, 0.1


# -- filters -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class FilterStep:
    """The condition of a filter and the objects that it removed, all of which had passed the previous filters."""

    asks: str
    taken: tuple[LibraryItem, ...]


def filtered(
    library: Library, axis: DistractorAxis, own: Iterable[str] = (), twin: Callable[[], Sequence[SceneObject]] = tuple
) -> tuple[tuple[LibraryItem, ...], list[FilterStep]]:
    """Return the library objects that pass all filters of an axis, and the objects removed by each filter.

    If the axis does not list categories, objects that could be confused with an object in the twin are also removed.
    With a second bowl in the scene, for example, "the bowl" in an instruction would be ambiguous. A library object
    without a category is compared by its name or, if the name is not a known word, by its size and shape.

    Args:
        library: The library.
        axis: The axis that specifies the filters.
        own: Categories, names and labels of the objects in the twin.
        twin: Function that returns the objects in the twin. It is called only if shapes must be compared.

    Raises:
        ImpossibleError: If distractors are requested, but no object passes the filters.
    """
    left, steps = library.items, list[FilterStep]()
    for asks, passes in _filters(axis, tuple(own), twin):
        taken = tuple(item for item in left if not passes(item))
        left = tuple(item for item in left if passes(item))
        steps.append(FilterStep(asks, taken))
    if not left and axis.count[1] > 0:
        raise ImpossibleError((_nothing_left(library, axis, steps),))
    return left, steps


def _filters(
    axis: DistractorAxis, own: tuple[str, ...], twin: Callable[[], Sequence[SceneObject]]
) -> Iterator[tuple[str, Callable[[LibraryItem], bool]]]:
    if axis.categories:
        yield f"category {_listed(axis.categories)}", lambda item: item.category in axis.categories
    elif own:
        yield KIND_OF_TWIN, lambda item: not _is_called(item, own)
        yield SHAPE_OF_TWIN, lambda item: not _is_nameless(item) or not _resembles(item, twin())
    if axis.exclude_categories:
        excluded = axis.exclude_categories
        yield f"not category {_listed(excluded)}", lambda item: not _is_called(item, excluded)
    for what, unit in (("mass", "kg"), ("volume", "m^3"), ("density", "kg/m^3")):
        bounds: ValueRange = getattr(axis, what)
        if bounds.min is not None or bounds.max is not None:
            yield f"{what} {_range(bounds)} {unit}", partial(_is_within, what, bounds)


def _is_within(what: str, bounds: ValueRange, item: LibraryItem) -> bool:
    return bool((bounds.min or 0.0) <= getattr(item, what) <= (math.inf if bounds.max is None else bounds.max))


def _is_called(item: LibraryItem, words: Iterable[str]) -> bool:
    """Return True if a word denotes an object.

    The word is compared with the object's specified category. If there is none, it is compared with the derived
    category and the name.
    """
    names = (item.category,) if item.stated else (item.category, item.name)
    return any(same_kind(word, name) for word in words for name in names)


def _is_nameless(item: LibraryItem) -> bool:
    """Return True if an object has no specified category and its name contains no known category word."""
    return not item.stated and category_prior(item.name) is None


def _resembles(item: LibraryItem, others: Sequence[SceneObject]) -> bool:
    """Return True if the size and shape of an object are similar to those of another object that is not fixed."""
    own = likeness(lowered(item.file))
    distances = (own.apart(likeness(other)) for other in others if not other.fixed)
    return any(d.size < math.log(LIKE_SIZE) and d.shape < LIKE_SHAPE for d in distances)


def remarks(library: Library, chosen: Sequence[LibraryItem], steps: Sequence[FilterStep]) -> tuple[str, ...]:
    """Return notes for the user about missing categories and about excluded objects that resemble the twin's."""
    found = [
        f"excluded {_few(step.taken)} from {library.title}: distractors need {step.asks}"
        for step in steps
        if step.taken and step.asks in (KIND_OF_TWIN, SHAPE_OF_TWIN)
    ]
    nameless = [item for item in chosen if not item.stated]
    if nameless:
        reason = f"no `category` is set for {_few(nameless)} in {library.title}, so only names and shapes were compared"
        found.append(f"{reason}; set it in these assets so that instructions cannot refer to them by accident")
    return tuple(found)


def _few(items: Sequence[LibraryItem], most: int = 5) -> str:
    names = ", ".join(f"`{item.name}`" for item in items[:most])
    return names if len(items) <= most else f"{names} and {len(items) - most} more"


def _nothing_left(library: Library, axis: DistractorAxis, steps: list[FilterStep]) -> Reason:
    """Return a reason that states how many library objects there are and how many of them each filter removed."""
    total = len(library.items)
    text = f"none of the {total} objects in {library.title} can be used as a distractor"
    numbers = {"library": float(total)}
    for step in (step for step in steps if step.taken):
        numbers[f"taken by {step.asks}"] = float(len(step.taken))
        text += f"; {step.asks}: {len(step.taken)} removed{_spread(step)}"
    known = sorted({item.category for item in library.items})
    unknown = [name for name in axis.categories if name not in known]
    if unknown and known:
        text += f"; category `{unknown[0]}` does not exist in it, {nearest(unknown[0], known)}"
    if library.faults:
        numbers["unusable"] = float(len(library.faults))
        file, why = library.faults[0]
        text += f"; unusable files: {len(library.faults)}, the first is {file}: {why}"
    return Reason("no_distractor", text, numbers)


def _spread(step: FilterStep) -> str:
    """Return a phrase with the range of the actual values for a filter by a quantity, or an empty string.

    An example is `` (actual values 0.012 to 4.1)``.
    """
    what = step.asks.split()[0]
    if what not in ("mass", "volume", "density"):
        return ""
    values = [getattr(item, what) for item in step.taken]
    return f" (actual values {min(values):.3g} to {max(values):.3g})"


def _range(bounds: ValueRange) -> str:
    if bounds.min is None:
        return f"at most {bounds.max:g}"
    return f"at least {bounds.min:g}" if bounds.max is None else f"{bounds.min:g} to {bounds.max:g}"


def _listed(names: Iterable[str]) -> str:
    return " or ".join(f"`{name}`" for name in names)
