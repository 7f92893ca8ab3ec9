"""Look up names as documents mean them: across bases, includes, copies, templates, assets, tasks and recipes."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from simfoundry.spec.compose.compose import MAX_BASES
from simfoundry.spec.compose.expand import INDICES
from simfoundry.spec.compose.join import SECTIONS
from simfoundry.spec.files import FileError, is_document, located
from simfoundry.spec.names.mentions import DocumentNames, Mention, Owner, Path_

# What the members of each section are called.
KINDS = {
    "objects": "object",
    "robots": "robot",
    "links": "link",
    "joints": "joint",
    "axes": "joint",  # positions and predicates refer to an axis as to a joint
    "sites": "site",
    "actuators": "actuator",
    "sensors": "sensor",
    "subtasks": "subtask",
    "cameras": "camera",
    "lights": "light",
    "materials": "material",
    "frames": "frame",
    "templates": "template",
    "include": "include",
    "parameters": "parameter",
    "parts": "part",
    "variants": "variant",
}

# Key that names the document in which a document looks up names, by the kind of the document.
_SCENE = {"task": "scene", "cousins": "twin", "capture": "truth"}

# Sections that documents define themselves although they look up other names in a scene.
_OWN = {"task": "subtasks", "capture": "frames"}

# Sections of assets that an object makes its own.
_OF_ASSETS = ("links", "joints", "sites", "actuators", "sensors")


@dataclass(frozen=True, slots=True)
class Symbol:
    """Something with a name.

    Attributes:
        kind: What it is, such as ``object`` or ``joint``.
        name: Its name, where it is defined.
        file: The resolved path of the document that defines it; those that extend this document change it.
        section: Path of the mapping in which it is defined, such as ``("links", "door", "parts")``.
    """

    kind: str
    name: str
    file: str
    section: Path_

    def __str__(self) -> str:
        return f"{self.kind} `{self.name}`"


# A member in a document: the resolved path of the document, and the path of the member.
_Layer = tuple[str, Path_]


@dataclass(frozen=True, slots=True)
class Meaning:
    """What a name means.

    Attributes:
        symbol: What is named.
        segments: The parts of the name that name something, with their start and end: includes, then the symbol.
        layers: The members that define and change it, the most derived first.
    """

    symbol: Symbol
    segments: tuple[tuple[Symbol | None, int, int], ...]
    layers: tuple[_Layer, ...]


def _meaning(symbol: Symbol, name: str, layers: tuple[_Layer, ...]) -> Meaning:
    return Meaning(symbol, ((symbol, 0, len(name)),), layers)


class NameLookup:
    """The names that are visible in each document.

    Args:
        root: Folder of the project. Documents outside are not read, except for those of packages.
        names_of: Function that returns the names in the document at a resolved path, or None.
    """

    def __init__(self, root: Path, names_of: Callable[[str], DocumentNames | None]) -> None:
        self.root = root
        self.read: dict[str, DocumentNames | None] = {}
        self._names_of = names_of
        self._looked_up: dict[tuple[str, str, str], Meaning | None] = {}
        self._located: dict[tuple[str, str], str | None] = {}
        self._chains: dict[str, tuple[str, ...]] = {}
        self._alternatives: dict[Symbol, dict[str, None]] = {}
        self._tails: dict[Symbol, dict[tuple[str, str], None]] = {}
        self._same: dict[Symbol, Symbol] = {}

    # -- documents --------------------------------------------------------------------------------------------------

    def document(self, file: str) -> DocumentNames | None:
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
        names = self.document(file)
        if names is None:
            return []
        written = [names.data.get("extends"), names.data.get(_SCENE.get(names.kind, ""))]
        written += [entry.get("scene") for entry in _entries(names.section("include"))]
        members = [*_entries(names.section("objects")), *_entries(names.section("templates"))]
        written += [asset for entry in members for asset in _assets(entry)]
        return list(dict.fromkeys(path for each in written if (path := self.locate(file, each)) is not None))

    def chain(self, file: str) -> tuple[str, ...]:
        """Return a document and the documents that it extends, the most derived first."""
        if file not in self._chains:
            found = [file]
            while len(found) <= MAX_BASES + 1:
                names = self.document(found[-1])
                base = self.locate(found[-1], names.data.get("extends")) if names is not None else None
                if base is None or base in found or self.document(base) is None:
                    break
                found.append(base)
            self._chains[file] = tuple(found)
        return self._chains[file]

    def _home(self, file: str, section: str) -> str | None:
        """Return the document that contains the names of a section which a document can use."""
        for _ in range(3):  # a recipe of a task of a scene
            names = self.document(file)
            if names is None:
                return None
            key = _SCENE.get(names.kind)
            if key is None or section == _OWN.get(names.kind):
                return file
            used = self._stated(file, (key,))
            if used is None:
                return None
            file = used
        return file

    def _stated(self, file: str, path: Path_) -> str | None:
        """Return the document that the value at a path refers to, in a document or the nearest one that it extends."""
        for layer in self.chain(file):
            names = self.document(layer)
            value = names.member(path) if names is not None else None
            if value is not None:
                return self.locate(layer, value)
        return None

    # -- names ------------------------------------------------------------------------------------------------------

    def resolve(self, file: str, mention: Mention) -> Meaning | None:
        """Return what a mention in a document means, or None if there is nothing with this name."""
        if mention.owner is None:
            found = (self.find(file, section, mention.name) for section in mention.sections)
            first = next((each for each in found if each is not None), None)
            if first is not None and mention.is_key:
                self._alternatives.setdefault(first.symbol, {}).update(dict.fromkeys(self._assets(first)))
            return first
        head = self.head(file, mention.owner)
        if head is None:
            return None
        for section in mention.sections:
            if (inner := self._member(file, head, section, mention.name)) is not None:
                if section in (*_OF_ASSETS, "parts"):
                    self._tails.setdefault(head.symbol, {})[section, mention.name] = None
                return inner
        return None

    def head(self, file: str, owner: Owner) -> Meaning | None:
        """Return the member whose own names are meant."""
        found = (self.find(file, section, owner.name) for section in owner.sections)
        return next((each for each in found if each is not None), None)

    def find(self, file: str, section: str, name: str) -> Meaning | None:
        """Return the member of a section that a name means in a document."""
        key = (file, section, name)
        if key not in self._looked_up:
            self._looked_up[key] = None  # until it is found, for cycles
            self._looked_up[key] = self._found(file, section, name)
        return self._looked_up[key]

    def _found(self, file: str, section: str, name: str) -> Meaning | None:
        names = self.document(file)
        if names is not None and names.kind == "policy":
            return self._only(section, name)
        home = self._home(file, section)
        if home is None:
            return None
        if home != file:
            return self.find(home, section, name)
        chain = [names for each in self.chain(file) if (names := self.document(each)) is not None]
        own = tuple((each.file, (section, name)) for each in chain if name in each.section(section))
        if section in SECTIONS and (included := self._included(chain, section, name)) is not None:
            return replace(included, layers=(*own, *included.layers))
        if section == "objects" and (copied := self._copied(file, name, own)) is not None:
            return replace(copied, layers=(*own, *copied.layers))
        if own:
            return _meaning(Symbol(KINDS[section], name, own[-1][0], (section,)), name, own)
        if section in ("joints", "axes"):
            return self._axis(chain, name)
        return None

    def _only(self, section: str, name: str) -> Meaning | None:
        """Return the only member of any scene with a name, for documents that can be used with every scene."""
        scenes = [file for file, names in self.read.items() if names is not None and names.kind == "scene"]
        found = [each for file in scenes if (each := self.find(file, section, name)) is not None]
        return found[0] if len({each.symbol for each in found}) == 1 else None

    def _included(self, chain: list[DocumentNames], section: str, name: str) -> Meaning | None:
        """Return the member of an included scene that a name with the prefix of the include means."""
        for prefix in dict.fromkeys(key for names in chain for key in names.section("include")):
            layers = tuple((names.file, ("include", prefix)) for names in chain if prefix in names.section("include"))
            include = Symbol(KINDS["include"], prefix, layers[-1][0], ("include",))
            entries = [self._data(layer) for layer in layers]
            if name == prefix and section == "frames" and any("pose" in entry for entry in entries):
                return _meaning(include, name, layers)
            if not name.startswith(f"{prefix}_"):
                continue
            scene = self._stated(chain[0].file, ("include", prefix, "scene"))
            rest = len(prefix) + 1
            inner = self.find(scene, section, name[rest:]) if scene is not None else None
            if inner is not None:
                shifted = tuple((symbol, start + rest, end + rest) for symbol, start, end in inner.segments)
                return Meaning(inner.symbol, ((include, 0, rest - 1), *shifted), inner.layers)
        return None

    def _copied(self, file: str, name: str, own: tuple[_Layer, ...]) -> Meaning | None:
        """Return the repeated object of which a name means a copy."""
        ending = INDICES.search(name)
        stem = name
        while ending is not None and len(stem) > ending.start():
            stem, _, _ = stem.rpartition("_")
            found = self.find(file, "objects", stem) if stem else None
            if found is None or not self._is_repeated(file, found):
                continue
            complete = any(key in self._data(layer) for layer in own for key in ("shape", "asset"))
            if not complete or self._has_copy(file, found, name[len(stem) + 1 :]):
                return found
        return None

    def _is_repeated(self, file: str, found: Meaning) -> bool:
        return any("repeat" in self._data(layer) for layer in self._with_templates(found.layers))

    def _has_copy(self, file: str, found: Meaning, indices: str) -> bool:
        """Return True if a repeated object has a copy with these indices, as far as its counts are numbers."""
        layers, seen = self._with_templates(found.layers), set[str]()
        while True:
            repeat = next((entry["repeat"] for layer in layers if "repeat" in (entry := self._data(layer))), None)
            leader = self.find(file, "objects", repeat) if isinstance(repeat, str) and repeat not in seen else None
            if leader is None:
                break
            seen.add(str(repeat))
            layers = self._with_templates(leader.layers)
        if not isinstance(repeat, dict):
            return False
        count = repeat.get("count", ())
        counts = [*(count if isinstance(count, tuple) else (count,)), *([repeat["stack"]] if "stack" in repeat else [])]
        given = indices.split("_")
        return len(given) == len(counts) and all(
            not isinstance(most, int) or 1 <= int(index) <= most for index, most in zip(given, counts, strict=True)
        )

    def _axis(self, chain: list[DocumentNames], name: str) -> Meaning | None:
        """Return the axis of a joint with several axes."""
        for names in reversed(chain):
            for joint, entry in names.section("joints").items():
                axes = entry.get("axes") if isinstance(entry, dict) else None
                if isinstance(axes, dict) and name in axes:
                    path: Path_ = ("joints", joint, "axes")
                    return _meaning(Symbol("joint", name, names.file, path), name, ((names.file, (*path, name)),))
        return None

    # -- members of members -----------------------------------------------------------------------------------------

    def _member(self, file: str, head: Meaning, section: str, name: str) -> Meaning | None:
        """Return what a name of a member means, such as ``drawer`` of a cabinet."""
        kind = head.symbol.kind
        if kind == "include":
            scene = self._stated(file, ("include", head.symbol.name, "scene"))
            return self.find(scene, section, name) if scene is not None and section == "parameters" else None
        if kind == "joint":
            return self.find(file, "axes", name)
        layers = self._with_templates(head.layers)
        if section == "variants" or kind == "link":
            return self._stated_in(section, name, [(each, (*path, section)) for each, path in layers])
        if section == "parts":
            found = self._stated_in(section, name, [*self._compounds(layers)])
            if found is not None:
                return found
        for asset in self._assets(head):
            if (inner := self._of_asset(asset, section, name)) is not None:
                return inner
        return None

    def _stated_in(self, section: str, name: str, places: list[_Layer]) -> Meaning | None:
        """Return the member with a name in the last of several mappings that contains it."""
        layers = tuple((file, (*path, name)) for file, path in places if name in self._data((file, path)))
        if not layers:
            return None
        file, path = layers[-1]
        return _meaning(Symbol(KINDS[section], name, file, path[:-1]), name, layers)

    def _compounds(self, layers: tuple[_Layer, ...]) -> Iterator[_Layer]:
        """Yield the mappings that contain the parts of an object's shape and of those of its variants."""
        for file, path in layers:
            variants = self._data((file, (*path, "variants")))
            for inner in ((), *(("variants", variant) for variant in variants)):
                yield file, (*path, *inner, "shape", "compound")

    def _of_asset(self, asset: str, section: str, name: str) -> Meaning | None:
        """Return what a name means among the links, joints or parts of an asset."""
        if section in _OF_ASSETS:
            return self.find(asset, section, name)
        places: list[_Layer] = []
        for file in self.chain(asset) if section == "parts" else ():
            names = self.document(file)
            places += (
                (file, ("links", link, "parts")) for link in (names.section("links") if names is not None else ())
            )
        return self._stated_in(section, name, places)

    def _with_templates(self, layers: tuple[_Layer, ...]) -> tuple[_Layer, ...]:
        """Return the layers of an object with those of the templates that complete it."""
        found = dict.fromkeys(layers)
        todo = list(layers)
        while todo:
            layer = todo.pop(0)
            like = self._data(layer).get("like")
            template = self.find(layer[0], "templates", like) if isinstance(like, str) else None
            new = [each for each in template.layers if each not in found] if template is not None else []
            found |= dict.fromkeys(new)
            todo += new
        return tuple(found)

    def _assets(self, head: Meaning) -> dict[str, None]:
        """Return the asset documents of an object and of its variants."""
        found: dict[str, None] = {}
        for layer in self._with_templates(head.layers) if head.symbol.kind in ("object", "template") else ():
            for reference in _assets(self._data(layer)):
                if (asset := self.locate(layer[0], reference)) is not None:
                    found[asset] = None
        return found

    def _data(self, layer: _Layer) -> dict[str, Any]:
        names = self.document(layer[0])
        value = names.member(layer[1]) if names is not None else None
        return value if isinstance(value, dict) else {}

    # -- symbols that share a name ----------------------------------------------------------------------------------

    def join_alternatives(self) -> None:
        """Join the members of assets that one text names together, because an object can have any of the assets."""
        for head, tails in self._tails.items():
            for section, name in tails:
                found = [self._of_asset(asset, section, name) for asset in self._alternatives.get(head, ())]
                symbols = [self.same(each.symbol) for each in found if each is not None]
                for symbol in symbols[1:]:
                    first, second = sorted((self.same(symbols[0]), self.same(symbol)), key=_order)
                    if first != second:
                        self._same[second] = first

    def same(self, symbol: Symbol) -> Symbol:
        """Return the symbol that stands for all symbols that must have the same name as this one."""
        while symbol in self._same:
            symbol = self._same[symbol]
        return symbol


def _order(symbol: Symbol) -> tuple[str, tuple[str, ...], str]:
    return symbol.file, tuple(map(str, symbol.section)), symbol.name


def _entries(section: dict[str, Any]) -> Iterator[dict[str, Any]]:
    yield from (entry for entry in section.values() if isinstance(entry, dict))


def _assets(entry: dict[str, Any]) -> Iterator[str]:
    """Yield the references of an object and its variants to asset documents."""
    variants = entry.get("variants")
    for each in (entry, *_entries(variants if isinstance(variants, dict) else {})):
        asset = each.get("asset")
        if isinstance(asset, str) and is_document(asset):
            yield asset
