"""Documents that refer to each other by files: bases, includes, assets, the scene of a task."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from simfoundry.spec.compose.compose import MAX_BASES
from simfoundry.spec.files import FileError, is_document, located
from simfoundry.spec.names.mentions import DocumentNames, Path_
from simfoundry.spec.names.symbols import Layer

# Key that names the document in which a document looks up names, by the kind of the document.
SCENE_KEYS = {"task": "scene", "cousins": "twin", "capture": "truth"}

# The kinds of documents that can be used with several scenes, and name cameras in them.
ANY_SCENE = ("policy", "dataset")


class LinkedDocuments:
    """The documents of a project, which are read when they are needed.

    Args:
        root: Folder of the project. Documents outside are not read, except for those of packages.
        names_of: Function that returns the names in the document at a resolved path, or None.
    """

    def __init__(self, root: Path, names_of: Callable[[str], DocumentNames | None]) -> None:
        self.root = root
        self.read: dict[str, DocumentNames | None] = {}
        self._names_of = names_of
        self._located: dict[tuple[str, str], str | None] = {}
        self._chains: dict[str, tuple[str, ...]] = {}

    def names(self, file: str) -> DocumentNames | None:
        """Return the names in a document, or None if it could not be parsed."""
        if file not in self.read:
            self.read[file] = None  # until it is read, for cycles
            self.read[file] = self._names_of(file)
        return self.read[file]

    def locate(self, file: str, reference: Any) -> str | None:
        """Return the resolved path of a document that a document refers to, or None if it may not be used."""
        if not isinstance(reference, str) or not reference or "\0" in reference:
            return None
        folder = file.rpartition(os.sep)[0]
        if (folder, reference) not in self._located:
            try:
                target = located(reference, Path(file))
                usable = reference.startswith("pkg:") or target.is_relative_to(self.root)
                self._located[folder, reference] = str(target) if usable and target.is_file() else None
            except (FileError, OSError, RuntimeError, ValueError):
                self._located[folder, reference] = None
        return self._located[folder, reference]

    def references(self, file: str) -> list[str]:
        """Return the documents that a document refers to, directly."""
        names = self.names(file)
        if names is None:
            return []
        written = [names.data.get("extends"), names.data.get(SCENE_KEYS.get(names.kind, ""))]
        written += [entry.get("scene") for entry in _entries(names.section("include"))]
        written.append(names.section("pictures").get("recipe"))
        members = [*_entries(names.section("objects")), *_entries(names.section("templates"))]
        written += [asset for entry in members for asset in asset_references(entry)]
        return list(dict.fromkeys(path for each in written if (path := self.locate(file, each)) is not None))

    def chain(self, file: str) -> tuple[str, ...]:
        """Return a document and the documents that it extends, the most derived first."""
        if file not in self._chains:
            found = [file]
            while len(found) <= MAX_BASES + 1:
                names = self.names(found[-1])
                base = self.locate(found[-1], names.data.get("extends")) if names is not None else None
                if base is None or base in found or self.names(base) is None:
                    break
                found.append(base)
            self._chains[file] = tuple(found)
        return self._chains[file]

    def stated(self, file: str, path: Path_) -> str | None:
        """Return the document that the value at a path refers to, in a document or the nearest one that it extends."""
        for layer in self.chain(file):
            names = self.names(layer)
            value = names.member(path) if names is not None else None
            if value is not None:
                return self.locate(layer, value)
        return None

    def data(self, layer: Layer) -> dict[str, Any]:
        """Return the data of a member, which is empty if there is none."""
        names = self.names(layer[0])
        value = names.member(layer[1]) if names is not None else None
        return value if isinstance(value, dict) else {}


def _entries(section: dict[str, Any]) -> Iterator[dict[str, Any]]:
    yield from (entry for entry in section.values() if isinstance(entry, dict))


def asset_references(entry: dict[str, Any]) -> Iterator[str]:
    """Yield the references of an object and its variants to asset documents."""
    variants = entry.get("variants")
    for each in (entry, *_entries(variants if isinstance(variants, dict) else {})):
        asset = each.get("asset")
        if isinstance(asset, str) and is_document(asset):
            yield asset
