"""A client that is not ours, with the capabilities that real editors declare."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest
from lsprotocol import types
from pytest_lsp import ClientServerConfig, client_capabilities

from tests.language_server.conftest import COMMAND, DESK

EDITORS = ["visual-studio-code", "neovim", "emacs"]


@pytest.mark.parametrize("editor", EDITORS)
def test_an_editor_sees_findings_as_its_user_types(project: Path, editor: str) -> None:
    asyncio.run(_session(project, editor))


async def _session(project: Path, editor: str) -> None:
    client: Any = await ClientServerConfig(server_command=COMMAND).start()  # its type states less than it has
    path = project / "desk.scene.yaml"
    uri = path.as_uri()
    await client.initialize_session(
        types.InitializeParams(capabilities=client_capabilities(editor), root_uri=project.as_uri())
    )
    item = types.TextDocumentItem(uri, "yaml", 1, DESK)
    client.text_document_did_open(types.DidOpenTextDocumentParams(item))
    await client.wait_for_notification(types.TEXT_DOCUMENT_PUBLISH_DIAGNOSTICS)
    assert list(client.diagnostics[uri]) == []
    start = types.Position(6, DESK.splitlines()[6].index("desk}"))
    change = types.TextDocumentContentChangePartial(types.Range(start, start), "x")
    document = types.VersionedTextDocumentIdentifier(version=2, uri=uri)
    client.text_document_did_change(types.DidChangeTextDocumentParams(document, [change]))
    await client.wait_for_notification(types.TEXT_DOCUMENT_PUBLISH_DIAGNOSTICS)
    (finding,) = client.diagnostics[uri]
    assert finding.code == "SF201" and finding.range == types.Range(start, types.Position(6, start.character + 5))
    await client.shutdown_session()
    await client.stop()
