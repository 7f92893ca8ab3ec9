"""Definitions, references and highlights of names, and the symbols of a project."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

from lsprotocol import types

from simfoundry.language_server.positions import Lines
from simfoundry.language_server.protocol import RequestFailedError
from simfoundry.language_server.workspace import Workspace
from simfoundry.spec.names.project import Occurrence, ProjectNames
from simfoundry.spec.names.rename import DocumentEdit
from simfoundry.spec.names.symbols import Symbol

# Returns the location of the characters between two offsets of a document, which is given by its resolved path.
Locate = Callable[[str, int, int], types.Location]

# Maximum number of symbols in answer to one query; editors ask again as the query grows.
MOST_SYMBOLS = 500

_KINDS = {
    "object": types.SymbolKind.Object,
    "robot": types.SymbolKind.Class,
    "link": types.SymbolKind.Struct,
    "part": types.SymbolKind.Struct,
    "joint": types.SymbolKind.Property,
    "site": types.SymbolKind.Field,
    "sensor": types.SymbolKind.Event,
    "actuator": types.SymbolKind.Function,
    "material": types.SymbolKind.Constant,
    "camera": types.SymbolKind.Interface,
    "parameter": types.SymbolKind.Variable,
    "template": types.SymbolKind.TypeParameter,
    "variant": types.SymbolKind.EnumMember,
    "subtask": types.SymbolKind.Method,
    "include": types.SymbolKind.Module,
    "frame": types.SymbolKind.Namespace,
}


def definitions(names: ProjectNames, path: Path, offset: int, locate: Locate) -> list[types.Location]:
    """Return the places that define the name at an offset."""
    symbol = _symbol(names, path, offset)
    return [] if symbol is None else [_location(each, locate) for each in names.definitions(symbol)]


def references(
    names: ProjectNames, path: Path, offset: int, locate: Locate, with_definitions: bool
) -> list[types.Location]:
    """Return the places in the project that use the name at an offset."""
    symbol = _symbol(names, path, offset)
    found = names.references(symbol) if symbol is not None else ()
    return [_location(each, locate) for each in found if with_definitions or not each.is_definition]


def highlights(names: ProjectNames, path: Path, offset: int, locate: Locate) -> list[types.DocumentHighlight]:
    """Return the places in the same document that mean the same as the name at an offset."""
    symbol, file = _symbol(names, path, offset), os.path.realpath(path)
    if symbol is None:
        return []
    return [
        types.DocumentHighlight(
            _location(each, locate).range,
            types.DocumentHighlightKind.Write if each.is_definition else types.DocumentHighlightKind.Read,
        )
        for each in names.references(symbol)
        if each.file == file
    ]


def renameable(names: ProjectNames, path: Path, offset: int, lines: Lines) -> types.PrepareRenamePlaceholder | None:
    """Return the range and the text of the name at an offset, or None if there is nothing that can be renamed."""
    found = names.at(path, offset)
    if found is None or found.symbol is None:
        return None
    return types.PrepareRenamePlaceholder(lines.range(found.start, found.end), found.symbol.name)


def workspace_edit(edits: Iterable[DocumentEdit], documents: Workspace) -> types.WorkspaceEdit:
    """Return edits of documents for the editor, each for the version of the text that it was made for.

    Raises:
        RequestFailedError: If the user has edited one of the documents meanwhile.
    """
    changes: list[types.TextDocumentEdit] = []
    for edit in edits:
        path = documents.shown(str(edit.file))
        buffer, lines = documents.buffer_of(path), Lines(edit.before, documents.encoding)
        if buffer is not None and buffer.lines.text != edit.before:
            raise RequestFailedError(f"{path.name} has been edited meanwhile; try again")
        version = buffer.version if buffer is not None else None
        identifier = types.OptionalVersionedTextDocumentIdentifier(documents.uri(path), version)
        replaced = [types.TextEdit(lines.range(each.start, each.end), each.new) for each in edit.edits]
        changes.append(types.TextDocumentEdit(identifier, replaced))
    return types.WorkspaceEdit(document_changes=changes)


def project_symbols(projects: Iterable[ProjectNames], query: str, locate: Locate) -> list[types.WorkspaceSymbol]:
    """Return the symbols of projects whose names contain the characters of a query in this order."""
    found = []
    for symbol in (each for names in projects for each in _defined(names)):
        if symbol.symbol is None or not _is_subsequence(query.casefold(), symbol.name.casefold()):
            continue
        kind = _KINDS.get(symbol.symbol.kind, types.SymbolKind.Variable)
        container = f"{symbol.symbol.kind} in {Path(symbol.file).name}"
        found.append(types.WorkspaceSymbol(_location(symbol, locate), symbol.name, kind, container_name=container))
        if len(found) == MOST_SYMBOLS:
            break
    return found


def _defined(names: ProjectNames) -> Iterator[Occurrence]:
    for file in sorted(names.documents):
        yield from (each for each in names.occurrences(file) if each.is_definition)


def _symbol(names: ProjectNames, path: Path, offset: int) -> Symbol | None:
    found = names.at(path, offset)
    return found.symbol if found is not None else None


def _location(occurrence: Occurrence, locate: Locate) -> types.Location:
    return locate(occurrence.file, occurrence.start, occurrence.end)


def _is_subsequence(query: str, name: str) -> bool:
    letters = iter(name)
    return all(letter in letters for letter in query)
