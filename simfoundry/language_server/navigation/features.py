"""Definitions, references, renames and symbols."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from lsprotocol import types

from simfoundry.language_server.display.links import file_at
from simfoundry.language_server.navigation import references as navigation
from simfoundry.language_server.protocol import RequestFailedError
from simfoundry.spec.names.project import ProjectNames
from simfoundry.spec.names.rename import RenameError

if TYPE_CHECKING:
    from simfoundry.language_server.server import Server

_PositionParams = (
    types.DefinitionParams | types.ReferenceParams | types.DocumentHighlightParams | types.PrepareRenameParams
)


def add_navigation(server: Server) -> None:
    """Register what finds the definitions and uses of names."""
    documents = server.documents

    async def names_at(params: _PositionParams) -> tuple[ProjectNames, Path, int] | None:
        """Return the names of the project, the document and the offset in it, or None if the document is not open."""
        buffer = documents.buffers.get(params.text_document.uri)
        if buffer is None:
            return None
        names = await server.look_up(documents.names, buffer.path)
        return names, buffer.path, buffer.lines.offset(params.position)

    @server.feature(types.TEXT_DOCUMENT_DEFINITION)
    async def definition(params: types.DefinitionParams) -> list[types.Location]:
        at = await names_at(params)
        if at is None:
            return []
        _, path, offset = at
        analysis = documents.parsed(path) or await server.current(params.text_document.uri)
        file = file_at(analysis, offset) if analysis is not None else None
        return (
            navigation.definitions(*at, documents.location) if file is None else [documents.location(str(file), 0, 0)]
        )

    @server.feature(types.TEXT_DOCUMENT_REFERENCES)
    async def references(params: types.ReferenceParams) -> list[types.Location]:
        at = await names_at(params)
        with_definitions = params.context.include_declaration
        return navigation.references(*at, documents.location, with_definitions) if at is not None else []

    @server.feature(types.TEXT_DOCUMENT_DOCUMENT_HIGHLIGHT)
    async def highlight(params: types.DocumentHighlightParams) -> list[types.DocumentHighlight]:
        at = await names_at(params)
        return navigation.highlights(*at, documents.location) if at is not None else []

    @server.feature(types.TEXT_DOCUMENT_PREPARE_RENAME)
    async def prepare_rename(params: types.PrepareRenameParams) -> types.PrepareRenamePlaceholder | None:
        at = await names_at(params)
        if at is None:
            return None
        return navigation.renameable(*at, documents.buffers[params.text_document.uri].lines)

    @server.feature(types.TEXT_DOCUMENT_RENAME, types.RenameOptions(prepare_provider=True))
    async def rename(params: types.RenameParams) -> types.WorkspaceEdit | None:
        buffer = documents.buffers.get(params.text_document.uri)
        if buffer is None:
            return None
        project, offset = documents.project(buffer.path), buffer.lines.offset(params.position)
        try:
            edits = await server.look_up(project.rename, buffer.path, offset, params.new_name)
        except RenameError as error:
            raise RequestFailedError(str(error)) from None
        return navigation.workspace_edit(edits, documents)

    @server.feature(types.WORKSPACE_SYMBOL)
    async def workspace_symbol(params: types.WorkspaceSymbolParams) -> list[types.WorkspaceSymbol]:
        projects = [await server.look_up(documents.names, folder) for folder in documents.folders()]
        return navigation.project_symbols(projects, params.query, documents.location)
