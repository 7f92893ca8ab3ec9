"""Synchronization of the server's texts with the editor and the disk."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING

from lsprotocol import types
from pygls.exceptions import JsonRpcException

from simfoundry.language_server.workspace import is_ours, path_of
from simfoundry.spec.files import MESH_SUFFIXES, PANORAMA_SUFFIXES, PICTURE_SUFFIXES, TEXTURE_SUFFIXES

if TYPE_CHECKING:
    from simfoundry.language_server.server import Server

# Suffixes of the files that documents refer to. The editor tells when such a file changes on disk.
WATCHED = (".yaml", *MESH_SUFFIXES, *TEXTURE_SUFFIXES, *PANORAMA_SUFFIXES, *PICTURE_SUFFIXES)


def add_synchronization(server: Server) -> None:
    """Register what keeps the texts of the server equal to those of the editor."""
    documents = server.documents

    @server.feature(types.INITIALIZED)
    async def initialized(ls: Server, _: types.InitializedParams) -> None:
        documents.encoding = ls.workspace.position_encoding or types.PositionEncodingKind.Utf16
        workspace = ls.client_capabilities.workspace
        watching = workspace.did_change_watched_files if workspace is not None else None
        if watching is not None and watching.dynamic_registration:
            watchers = [types.FileSystemWatcher(f"**/*{suffix}") for suffix in dict.fromkeys(WATCHED)]
            options = types.DidChangeWatchedFilesRegistrationOptions(watchers)
            method = types.WORKSPACE_DID_CHANGE_WATCHED_FILES
            with suppress(JsonRpcException):  # an editor that cannot watch files after all
                await ls.client_register_capability_async(
                    types.RegistrationParams([types.Registration("files", method, options)])
                )

    @server.feature(types.TEXT_DOCUMENT_DID_OPEN)
    async def did_open(ls: Server, params: types.DidOpenTextDocumentParams) -> None:
        item = params.text_document
        ls.show(documents.open(item.uri, item.text, item.version))

    @server.feature(types.TEXT_DOCUMENT_DID_CHANGE)
    async def did_change(ls: Server, params: types.DidChangeTextDocumentParams) -> None:
        item = params.text_document
        buffer = documents.change(item.uri, params.content_changes, item.version)
        if buffer is not None:
            ls.show(buffer)

    @server.feature(types.TEXT_DOCUMENT_DID_SAVE)
    async def did_save(ls: Server, params: types.DidSaveTextDocumentParams) -> None:
        documents.texts.forget()
        documents.rescan()
        path = path_of(params.text_document.uri)
        ls.check_dependents(path, await ls.look_up(documents.dependents, path))

    @server.feature(types.TEXT_DOCUMENT_DID_CLOSE)
    async def did_close(ls: Server, params: types.DidCloseTextDocumentParams) -> None:
        buffer = documents.close(params.text_document.uri)
        if buffer is None:
            return
        for listener in ls.closed:
            listener(buffer.uri, buffer.path)
        dependents = await ls.look_up(documents.dependents, buffer.path)
        if documents.buffer_of(buffer.path) is not None:
            return  # it was opened again
        ls.withdraw(buffer.path)
        concerned = {each.path for each in documents.buffers.values()}
        for path in tuple(concerned):
            concerned |= await ls.look_up(documents.dependents, path)
        concerned |= {each.path for each in documents.buffers.values()}  # those that were opened meanwhile
        for path in documents.analyzed_files() - concerned:
            ls.withdraw(path)
        ls.check_dependents(buffer.path, dependents & concerned)  # they see the text on disk again

    @server.feature(types.WORKSPACE_DID_CHANGE_WATCHED_FILES)
    async def did_change_files(ls: Server, _: types.DidChangeWatchedFilesParams) -> None:
        documents.texts.forget()
        documents.rescan()
        for buffer in documents.buffers.values():
            if is_ours(buffer):
                ls.check(buffer.path, changed=False)
