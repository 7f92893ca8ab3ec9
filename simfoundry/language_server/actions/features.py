"""Corrections of findings, and rewrites of values."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lsprotocol import types

from simfoundry.language_server.actions.offers import KINDS, code_actions

if TYPE_CHECKING:
    from simfoundry.language_server.server import Server


def add_actions(server: Server) -> None:
    """Register the corrections of findings, and the rewrites of values."""

    @server.feature(types.TEXT_DOCUMENT_CODE_ACTION, types.CodeActionOptions(code_action_kinds=KINDS))
    async def code_action(ls: Server, params: types.CodeActionParams) -> list[types.CodeAction]:
        analysis = await ls.current(params.text_document.uri)
        if analysis is None:
            return []
        findings = [*analysis.findings, *ls.documents.findings(analysis.path)]
        uri, only = params.text_document.uri, params.context.only
        return await ls.run(code_actions, analysis, findings, uri, params.range, only)
