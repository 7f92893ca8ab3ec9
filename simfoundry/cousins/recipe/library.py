"""Distractor libraries: folders of assets and meshes, with the measured mass, volume and density of each object.

An object's mass is the mass of the lowered asset. Its volume is the total volume of its convex parts. For a cup, for
example, this is the volume of the wall. Both are measured once and cached.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from simfoundry.assets.cache import Cache, key_of
from simfoundry.cousins.recipe.candidate import free_name
from simfoundry.errors import SimfoundryError
from simfoundry.runtime.files import shipped
from simfoundry.scene.model import SceneObject
from simfoundry.spec.diagnostics import SpecError
from simfoundry.spec.files import ASSET_SUFFIX, MESH_SUFFIXES, Loaded
from simfoundry.spec.load import load

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
    from simfoundry.geometry.shapes import Box, Capsule, Cone, Cylinder, Ellipsoid, Mesh, Sphere

    match geometry:
        case Box(size):
            return mass.box(size).volume
        case Sphere(radius):
            return mass.sphere(radius).volume
        case Cylinder(radius, height):
            return mass.cylinder(radius, height).volume
        case Capsule(radius, height):
            return mass.capsule(radius, height).volume
        case Ellipsoid(radii):
            return mass.ellipsoid(radii).volume
        case Cone(radius, height):
            return mass.cone(radius, height).volume
        case Mesh(vertices, faces):
            return abs(float(mass.mesh(vertices, faces).volume))
    raise TypeError(f"unknown geometry: {geometry!r}")
