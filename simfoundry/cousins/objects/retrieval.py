"""Variants from a library: assets and meshes of a folder, like the twin in kind, size and shape, scaled to it."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from simfoundry.assets.cache import Cache
from simfoundry.cousins.objects.item import Item, item_of_asset, item_of_mesh, lay, lowered
from simfoundry.cousins.objects.likeness import Likeness, likeness
from simfoundry.cousins.objects.procedural import Draft
from simfoundry.cousins.objects.stretch import stretched
from simfoundry.cousins.objects.stuff import same_kind
from simfoundry.cousins.reasons import Reason
from simfoundry.errors import SimfoundryError
from simfoundry.spec.diagnostics import SpecError
from simfoundry.spec.files import MESH_SUFFIXES
from simfoundry.spec.load import load
from simfoundry.spec.models.asset import AssetSpec
from simfoundry.spec.models.base import Material
from simfoundry.spec.models.cousins import ObjectVariants

LEAST, MOST = 0.5, 2.0
"""Factors by which a thing of a library is scaled to the twin's size."""

STRANGER = 3.0
"""What is of another kind counts as this much farther away, in the units of :attr:`Apart.distance`."""

USUAL = Material(density=700.0, friction=0.5, restitution=0.1)
"""What a mesh is made of where the twin does not say."""


@dataclass(frozen=True, eq=False)
class Entry:
    """A thing of a library, and what it looks like."""

    item: Item
    likeness: Likeness


class Library:
    """What a folder offers: asset documents, and mesh files, whose category is the name of the folder that they are in.

    ``left_out`` are files that cannot be used, with why. Raises :class:`SimfoundryError` where there is no folder.
    """

    def __init__(self, folder: Path, cache: Cache | None = None, scale: float = 1.0) -> None:
        if not folder.is_dir():
            raise SimfoundryError(f"the library {folder} is no folder")
        self.folder = folder
        self.left_out: dict[str, str] = {}
        self.entries: list[Entry] = []
        for path in sorted(folder.rglob("*")):
            if path.name.endswith(".asset.yaml") or path.suffix.lower() in MESH_SUFFIXES:
                self._add(path, cache, scale)

    def _add(self, path: Path, cache: Cache | None, scale: float) -> None:
        try:
            item = _read(path, self.folder, scale)
            thing = lowered(item.spec, path.parent, item.name, cache)
        except SpecError as error:
            self.left_out[path.relative_to(self.folder).as_posix()] = error.diagnostics[0].message
            return
        self.entries.append(Entry(item, likeness(thing)))

    def ranked(self, item: Item, like: Likeness) -> list[tuple[float, float, Entry]]:
        """The entries from the most alike: distance, the factor that scales it to the twin's size, and the entry.

        An entry that is the twin itself, by its document, is not among them.
        """
        found = []
        for k, entry in enumerate(self.entries):
            if entry.item.spec.links == item.spec.links:
                continue
            factor = float(np.exp(np.mean(np.log(like.size / entry.likeness.size))))
            factor = min(max(factor, LEAST), MOST)
            sides = np.abs(np.log(entry.likeness.size * factor / like.size)).max() / np.log(1.06)
            shape = np.abs(entry.likeness.shape - like.shape).sum() / 2 / 0.06
            away = float(sides + shape) + (0.0 if same_kind(entry.item.category, item.category) else STRANGER)
            found.append((away, k, factor, entry))
        return [(away, factor, entry) for away, _, factor, entry in sorted(found, key=lambda row: row[:2])]


class Retrieval:
    """A source of candidates: the entries of a library in the order of their likeness to the twin."""

    def __init__(self, library: Library) -> None:
        self.library = library
        self._ranked: dict[str, list[tuple[float, float, Entry]]] = {}

    def __call__(self, item: Item, axis: ObjectVariants, seed: int, k: int) -> Draft | Reason:
        """Candidate ``k``: the next entry when its turn has come round to this source."""
        if item.name not in self._ranked:
            self._ranked[item.name] = self.library.ranked(item, _likeness_of(item))
        ranked = self._ranked[item.name]
        place = k // len(axis.sources)
        if place >= len(ranked):
            count = len(ranked)
            text = f"the library has {count} things beside the twin, and this is the {place + 1}th that is asked for"
            return Reason("library", text, {"entries": float(count), "place": float(place)})
        away, factor, entry = ranked[place]
        if not same_kind(entry.item.category, item.category):
            text = f"the next in the library, `{entry.item.name}`, is a {entry.item.category}, and no {item.category}"
            return Reason("kind", text, {"distance": away})
        spec = stretched(entry.item.spec, np.full(3, factor))
        words = f"{entry.item.source} of the library, scaled by {factor:.2f}, at distance {away:.1f}"
        return Draft(_flat(spec), (words,), kept=entry.item.files)


def contents(folder: Path) -> dict[str, str]:
    """What a library holds: the SHA-256 of each file by its path in the folder, sorted."""
    files = (p for p in sorted(folder.rglob("*")) if p.is_file())
    return {p.relative_to(folder).as_posix(): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}


def _read(path: Path, folder: Path, scale: float) -> Item:
    if path.name.endswith(".asset.yaml"):
        loaded = load(path)
        if loaded.errors or not isinstance(loaded.spec, AssetSpec):
            raise SpecError(loaded.errors or [loaded.finding("SF006", ("simfoundry",), "it is no asset")])
        return item_of_asset(loaded)
    inside = path.relative_to(folder).parts
    name = _name(
        inside[-2] if len(inside) > 1 and path.stem in ("mesh", "model", "textured", "textured_simple") else path.stem
    )
    category = _name(inside[0] if len(inside) > 1 else path.stem)
    return item_of_mesh(path, name, category, USUAL, scale)


def _name(text: str) -> str:
    """A file's name as names are written here: ``025_mug`` is ``mug``."""
    kept = "".join(c if c.isalnum() and c.isascii() else "_" for c in text.lower()).strip("_0123456789-")
    return kept or "thing"


def _flat(spec: AssetSpec) -> AssetSpec:
    return spec.model_copy(update={"description": None, "origin": None})


def _likeness_of(item: Item) -> Likeness:
    with TemporaryDirectory(prefix="simfoundry-likeness-") as folder:
        lay(item.files, Path(folder))
        return likeness(lowered(item.spec, Path(folder), item.name))
