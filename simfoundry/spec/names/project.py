"""The symbols of a project, with their definitions and uses."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

from simfoundry.spec.names.linked import LinkedDocuments
from simfoundry.spec.names.lookup import NameLookup
from simfoundry.spec.names.mentions import DocumentNames, Mention, Sections, document_names
from simfoundry.spec.names.symbols import HEADS, Meaning, Symbol
from simfoundry.spec.yaml.nodes import YamlError
from simfoundry.spec.yaml.text import Document, Read, read

# Documents and their names, by resolved path. A document that is the same object as before is not walked again.
NamesCache = dict[str, tuple[Document, DocumentNames]]


@dataclass(frozen=True, slots=True)
class Occurrence:
    """A place at which a text names something.

    Attributes:
        symbol: What is named, or None if there is nothing with this name.
        name: The name as it is written here: ``mug`` in ``left_mug``, if ``left`` is an include.
        file: The resolved path of the document.
        start: Offset of the first character, counted from 0; see ``line`` and ``column`` for what findings show.
        end: Offset after the last character.
        line: Line of the first character, counted from 1.
        column: Column of the first character, counted from 1; a byte order mark does not count.
        path: Path in the document.
        sections: Where the name was looked up.
        is_key: True if it is a key, or a part of one.
        is_definition: True if this is the key that defines the symbol, rather than one that changes or uses it.
    """

    symbol: Symbol | None
    name: str
    file: str
    start: int
    end: int
    line: int
    column: int
    path: tuple[str | int, ...]
    sections: Sections
    is_key: bool
    is_definition: bool


@dataclass
class ProjectNames:
    """The names of the documents of one project, with those of all documents that they use.

    Attributes:
        root: The folder of the project.
        files: The documents. Documents that they use are read as well if they are in the project or in a package.
        reader: Function that reads a document, such as that of the open documents of an editor. It returns documents as
            they were parsed.
        cache: Names of documents from before, which is updated.
    """

    root: Path
    files: Iterable[Path]
    reader: Read = read
    cache: NamesCache = field(default_factory=dict)
    unreadable: dict[str, YamlError] = field(default_factory=dict, init=False)
    """Errors of the documents that could not be parsed, by resolved path."""

    def __post_init__(self) -> None:
        self._linked = LinkedDocuments(self.root.resolve(), self._read)
        self._lookup = NameLookup(self._linked)
        todo = [os.path.realpath(file) for file in self.files]
        while todo:
            file = todo.pop()
            if file not in self._linked.read and self._linked.names(file) is not None:
                todo += self._linked.references(file)

    def _read(self, file: str) -> DocumentNames | None:
        try:
            document = self.reader(Path(file))
        except YamlError as error:
            self.unreadable[file] = error
            return None
        known = self.cache.get(file)
        if known is None or known[0] is not document:
            self.cache[file] = known = (document, document_names(document, file))
        return known[1]

    @property
    def documents(self) -> dict[str, DocumentNames]:
        """Return the documents that could be parsed, by resolved path."""
        return {file: names for file, names in self._linked.read.items() if names is not None}

    def occurrences(self, file: Path | str) -> tuple[Occurrence, ...]:
        """Return the occurrences of names in a document, in the order of its text."""
        return self._occurrences.get(os.path.realpath(file), ())

    def at(self, file: Path | str, offset: int) -> Occurrence | None:
        """Return the occurrence that contains a character, or that ends before it, or None if there is none."""
        near = [o for o in self.occurrences(file) if o.start <= offset <= o.end]
        return max(near, key=lambda o: (offset < o.end, o.symbol is not None), default=None)

    def references(self, symbol: Symbol) -> tuple[Occurrence, ...]:
        """Return all occurrences of a symbol in the project, including its definitions, by file and place."""
        return tuple(self._by_symbol.get(symbol, ()))

    def definitions(self, symbol: Symbol) -> tuple[Occurrence, ...]:
        """Return the keys that define a symbol.

        There are several if an object has several assets that define the same link, which must have the same name.
        """
        return tuple(o for o in self.references(symbol) if o.is_definition)

    def symbols(self, file: Path | str, name: str, sections: Sections) -> list[Symbol]:
        """Return what a name means in a document, by section, without duplicates."""
        found = (self._lookup.find(os.path.realpath(file), section, name) for section in sections)
        return list(dict.fromkeys(self.same(each.symbol) for each in found if each is not None))

    def meaning(self, file: Path | str, section: str, name: str) -> Meaning | None:
        """Return what a name of a section means in a document, or None if nothing has this name."""
        return self._lookup.find(os.path.realpath(file), section, name)

    def members(self, file: Path | str, names: tuple[str, ...]) -> list[Symbol]:
        """Return what a name such as ``cabinet.drawer`` means in a document, without duplicates."""
        found: list[Symbol] = []
        head, *_, name = names
        for section in HEADS:
            owner = self._lookup.find(os.path.realpath(file), section, head)
            inner = [] if owner is None else self._lookup.members(os.path.realpath(file), owner, name)
            found += [self.same(each.symbol) for each in inner]
        return list(dict.fromkeys(found))

    def same(self, symbol: Symbol) -> Symbol:
        """Return the symbol that stands for all symbols that must have the same name as this one."""
        assert self._occurrences is not None  # which finds them
        return self._lookup.same(symbol)

    def dependencies(self, file: Path | str) -> frozenset[str]:
        """Return the documents that a document refers to, directly."""
        return frozenset(self._linked.references(os.path.realpath(file)))

    def dependents(self, file: Path | str) -> frozenset[str]:
        """Return the documents that a change of a document can affect, directly or by other documents."""
        found = set[str]()
        todo = [os.path.realpath(file)]
        while todo:
            new = self._users.get(todo.pop(), set()) - found
            found |= new
            todo += new
        return frozenset(found)

    @cached_property
    def _users(self) -> dict[str, set[str]]:
        users: dict[str, set[str]] = {}
        for file in self.documents:
            for used in self._linked.references(file):
                users.setdefault(used, set()).add(file)
        return users

    @cached_property
    def _occurrences(self) -> dict[str, tuple[Occurrence, ...]]:
        documents = dict(self.documents)
        found = {file: [(m, self._resolve(names, m)) for m in names.mentions] for file, names in documents.items()}
        self._lookup.join_alternatives()
        return {
            file: tuple(
                occurrence
                for mention, meaning in pairs
                if meaning is not None or not (mention.is_optional or self._is_foreign(documents[file], mention))
                for occurrence in self._placed(documents[file], mention, meaning)
            )
            for file, pairs in found.items()
        }

    def _resolve(self, names: DocumentNames, mention: Mention) -> Meaning | None:
        """Return what a mention means, in its own document or in one that extends it."""
        todo, seen = [names.file], set[str]()
        while todo:
            file = todo.pop(0)
            seen.add(file)
            found = self._lookup.resolve(file, mention)
            if found is not None:
                return found
            users = self._users.get(file, set())
            todo += sorted(u for u in users - seen if file in self._linked.chain(u)[1:])
        return None

    def _is_foreign(self, names: DocumentNames, mention: Mention) -> bool:
        """Return True if a name belongs to something that documents do not describe, such as a link of a robot."""
        owner = mention.owner
        if owner is None:
            return False
        head = self._lookup.head(names.file, owner)
        return head is None or head.symbol.kind == "robot"

    def _placed(self, names: DocumentNames, mention: Mention, meaning: Meaning | None) -> Iterator[Occurrence]:
        """Yield the occurrences in a mention: several for a name with the prefix of an include."""
        whole = mention.end - mention.start == len(mention.name)  # else it is written with escapes
        segments = meaning.segments if meaning is not None else ((None, 0, len(mention.name)),)
        for symbol, first, last in segments:
            start, end = (mention.start + first, mention.start + last) if whole else (mention.start, mention.end)
            is_definition = (
                symbol is not None
                and mention.is_key
                and symbol.file == names.file
                and mention.path == (*symbol.section, symbol.name)
            )
            yield Occurrence(
                None if symbol is None else self._lookup.same(symbol),
                mention.name[first:last],
                names.file,
                start,
                end,
                *names.index.place(start),
                mention.path,
                mention.sections,
                mention.is_key,
                is_definition,
            )

    @cached_property
    def _by_symbol(self) -> dict[Symbol, list[Occurrence]]:
        found: dict[Symbol, list[Occurrence]] = {}
        for _, occurrences in sorted(self._occurrences.items()):
            for occurrence in occurrences:
                if occurrence.symbol is not None:
                    found.setdefault(occurrence.symbol, []).append(occurrence)
        return found
