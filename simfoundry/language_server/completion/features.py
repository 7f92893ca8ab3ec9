"""Completion, and the signatures of predicates."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lsprotocol import types

from simfoundry.language_server.completion.complete import (
    SIGNATURE_TRIGGERS,
    TRIGGERS,
    complete,
    has_snippets,
    signature,
)

if TYPE_CHECKING:
    from simfoundry.language_server.server import Server


def add_completion(server: Server) -> None:
    """Register completion and the signatures of predicates. Both use the current text, without waiting for checks."""
    documents = server.documents

    @server.feature(types.TEXT_DOCUMENT_COMPLETION, types.CompletionOptions(trigger_characters=list(TRIGGERS)))
    async def completion(ls: Server, params: types.CompletionParams) -> types.CompletionList | None:
        buffer = documents.buffers.get(params.text_document.uri)
        if buffer is None:
            return None
        snippets = has_snippets(ls.client_capabilities)
        return complete(buffer.path, buffer.lines, params.position, documents.parsed(buffer.path), snippets)

    @server.feature(
        types.TEXT_DOCUMENT_SIGNATURE_HELP, types.SignatureHelpOptions(trigger_characters=list(SIGNATURE_TRIGGERS))
    )
    async def signature_help(params: types.SignatureHelpParams) -> types.SignatureHelp | None:
        buffer = documents.buffers.get(params.text_document.uri)
        return signature(buffer.lines, params.position) if buffer is not None else None
