"""Look up names as documents mean them: across bases, includes, copies, templates, assets, tasks and recipes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from simfoundry.spec.compose.expand import INDICES
from simfoundry.spec.compose.join import SECTIONS
from simfoundry.spec.names.linked import ANY_SCENE, SCENE_KEYS, LinkedDocuments, asset_references
from simfoundry.spec.names.mentions import DocumentNames, Mention, Owner, Path_
from simfoundry.spec.names.symbols import KINDS, Layer, Meaning, Symbol, plain_meaning

# Sections that documents define themselves although they look up other names in a scene.
_OWN = {"task": "subtasks", "capture": "frames"}

# Sections of assets that an object makes its own.
_OF_ASSETS = ("links", "joints", "sites", "actuators", "sensors")


class NameLookup:
    """The names that are visible in each document."""

    def __init__(self, documents: LinkedDocuments) -> None:
        self.documents = documents
        self._looked_up: dict[tuple[str, str, str], Meaning | None] = {}
        self._alternatives: dict[Symbol, dict[str, None]] = {}
        self._tails: dict[Symbol, dict[tuple[str, str], None]] = {}
        self._same: dict[Symbol, Symbol] = {}

    def _home(self, file: str, section: str) -> str | None:
        """Return the document that contains the names of a section which a document can use."""
        for _ in range(3):  # a recipe of a task of a scene
            names = self.documents.names(file)
            if names is None:
                return None
            key = SCENE_KEYS.get(names.kind)
            if key is None or section == _OWN.get(names.kind):
                return file
            used = self.documents.stated(file, (key,))
            if used is None:
                return None
            file = used
        return file

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
        names = self.documents.names(file)
        if names is not None and names.kind in ANY_SCENE:
            return self._only(section, name)
        home = self._home(file, section)
        if home is None:
            return None
        if home != file:
            return self.find(home, section, name)
        chain = [names for each in self.documents.chain(file) if (names := self.documents.names(each)) is not None]
        own = tuple((each.file, (section, name)) for each in chain if name in each.section(section))
        if section in SECTIONS and (included := self._included(chain, section, name)) is not None:
            return replace(included, layers=(*own, *included.layers))
        if section == "objects" and (copied := self._copied(file, name, own)) is not None:
            return replace(copied, layers=(*own, *copied.layers))
        if own:
            return plain_meaning(Symbol(KINDS[section], name, own[-1][0], (section,)), name, own)
        if section in ("joints", "axes"):
            return self._axis(chain, name)
        return None

    def _only(self, section: str, name: str) -> Meaning | None:
        """Return the only member of any scene with a name, for documents that can be used with every scene."""
        scenes = [file for file, names in self.documents.read.items() if names is not None and names.kind == "scene"]
        found = [each for file in scenes if (each := self.find(file, section, name)) is not None]
        return found[0] if len({each.symbol for each in found}) == 1 else None

    def _included(self, chain: list[DocumentNames], section: str, name: str) -> Meaning | None:
        """Return the member of an included scene that a name with the prefix of the include means."""
        for prefix in dict.fromkeys(key for names in chain for key in names.section("include")):
            layers = tuple((names.file, ("include", prefix)) for names in chain if prefix in names.section("include"))
            include = Symbol(KINDS["include"], prefix, layers[-1][0], ("include",))
            entries = [self.documents.data(layer) for layer in layers]
            if name == prefix and section == "frames" and any("pose" in entry for entry in entries):
                return plain_meaning(include, name, layers)
            if not name.startswith(f"{prefix}_"):
                continue
            scene = self.documents.stated(chain[0].file, ("include", prefix, "scene"))
            rest = len(prefix) + 1
            inner = self.find(scene, section, name[rest:]) if scene is not None else None
            if inner is not None:
                shifted = tuple((symbol, start + rest, end + rest) for symbol, start, end in inner.segments)
                return Meaning(inner.symbol, ((include, 0, rest - 1), *shifted), inner.layers)
        return None

    def _copied(self, file: str, name: str, own: tuple[Layer, ...]) -> Meaning | None:
        """Return the repeated object of which a name means a copy."""
        ending = INDICES.search(name)
        stem = name
        while ending is not None and len(stem) > ending.start():
            stem, _, _ = stem.rpartition("_")
            found = self.find(file, "objects", stem) if stem else None
            if found is None or not self._is_repeated(file, found):
                continue
            complete = any(key in self.documents.data(layer) for layer in own for key in ("shape", "asset"))
            if not complete or self._has_copy(file, found, name[len(stem) + 1 :]):
                return found
        return None

    def _is_repeated(self, file: str, found: Meaning) -> bool:
        return any("repeat" in self.documents.data(layer) for layer in self._with_templates(found.layers))

    def _has_copy(self, file: str, found: Meaning, indices: str) -> bool:
        """Return True if a repeated object has a copy with these indices, as far as its counts are numbers."""
        layers, seen = self._with_templates(found.layers), set[str]()
        while True:
            repeat = next(
                (entry["repeat"] for layer in layers if "repeat" in (entry := self.documents.data(layer))), None
            )
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
                    return plain_meaning(Symbol("joint", name, names.file, path), name, ((names.file, (*path, name)),))
        return None

    # -- members of members -----------------------------------------------------------------------------------------

    def members(self, file: str, head: Meaning, name: str) -> Iterator[Meaning]:
        """Yield what a name of a member can mean, in every section."""
        for section in (*_OF_ASSETS, "parts", "variants", "parameters"):
            if (found := self._member(file, head, section, name)) is not None:
                yield found

    def _member(self, file: str, head: Meaning, section: str, name: str) -> Meaning | None:
        """Return what a name of a member means, such as ``drawer`` of a cabinet."""
        kind = head.symbol.kind
        if kind == "include":
            scene = self.documents.stated(file, ("include", head.symbol.name, "scene"))
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

    def _stated_in(self, section: str, name: str, places: list[Layer]) -> Meaning | None:
        """Return the member with a name in the last of several mappings that contains it."""
        layers = tuple((file, (*path, name)) for file, path in places if name in self.documents.data((file, path)))
        if not layers:
            return None
        file, path = layers[-1]
        return plain_meaning(Symbol(KINDS[section], name, file, path[:-1]), name, layers)

    def _compounds(self, layers: tuple[Layer, ...]) -> Iterator[Layer]:
        """Yield the mappings that contain the parts of an object's shape and of those of its variants."""
        for file, path in layers:
            variants = self.documents.data((file, (*path, "variants")))
            for inner in ((), *(("variants", variant) for variant in variants)):
                yield file, (*path, *inner, "shape", "compound")

    def _of_asset(self, asset: str, section: str, name: str) -> Meaning | None:
        """Return what a name means among the links, joints or parts of an asset."""
        if section in _OF_ASSETS:
            return self.find(asset, section, name)
        places: list[Layer] = []
        for file in self.documents.chain(asset) if section == "parts" else ():
            names = self.documents.names(file)
            places += (
                (file, ("links", link, "parts")) for link in (names.section("links") if names is not None else ())
            )
        return self._stated_in(section, name, places)

    def _with_templates(self, layers: tuple[Layer, ...]) -> tuple[Layer, ...]:
        """Return the layers of an object with those of the templates that complete it."""
        found = dict.fromkeys(layers)
        todo = list(layers)
        while todo:
            layer = todo.pop(0)
            like = self.documents.data(layer).get("like")
            template = self.find(layer[0], "templates", like) if isinstance(like, str) else None
            new = [each for each in template.layers if each not in found] if template is not None else []
            found |= dict.fromkeys(new)
            todo += new
        return tuple(found)

    def _assets(self, head: Meaning) -> dict[str, None]:
        """Return the asset documents of an object and of its variants."""
        found: dict[str, None] = {}
        for layer in self._with_templates(head.layers) if head.symbol.kind in ("object", "template") else ():
            for reference in asset_references(self.documents.data(layer)):
                if (asset := self.documents.locate(layer[0], reference)) is not None:
                    found[asset] = None
        return found

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
