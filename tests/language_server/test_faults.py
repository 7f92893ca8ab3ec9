"""What no editor should send, and files that change behind the editor's back."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from tests.corpora.editor_faults import faults
from tests.editor.client import Server, framed
from tests.language_server.conftest import COMMAND, DESK

BROKEN = DESK.replace("on: desk", "on: dsk")


@pytest.mark.slow  # 5 s
def test_random_edits_and_messages_leave_the_findings_right(tmp_path: Path) -> None:
    (folder := tmp_path.resolve() / "project").mkdir()
    assert faults(folder, edits=40, seed=3) == []


@pytest.mark.parametrize(
    "sent",
    [
        framed(b"{"),
        framed(b"[1, 2]"),
        framed(b"[" * 50_000),
        framed(b'{"jsonrpc": "2.0", "method": "textDocument/didOpen", "params": {"textDocument": []}}'),
        b'Content-Length: 4\r\n\r\n{"jsonrpc": "2.0"}\r\n',
        b"\xff\r\n\r\n",
    ],
)
def test_what_is_not_a_message_is_ignored(server: Server, project: Path, sent: bytes) -> None:
    path = project / "desk.scene.yaml"
    server.open(path, BROKEN)
    server.send_bytes(sent)
    assert [one["code"] for one in server.diagnostics(path)] == ["SF201"]
    assert server.diagnostics_of(path, server.change(path, DESK)) == []


@pytest.mark.parametrize("document", [None, 5, {"uri": "file://[::1"}])
def test_a_request_of_wrong_types_is_answered(server: Server, document: object) -> None:
    with pytest.raises(RuntimeError, match="Invalid Params"):
        server.ask("textDocument/completion", textDocument=document, position={"line": 0, "character": 0})


def test_a_request_for_a_document_that_is_not_open_is_answered(server: Server) -> None:
    place = {"line": 0, "character": 0}
    assert server.ask("textDocument/completion", textDocument={"uri": 7}, position=place) is None
    assert server.ask("textDocument/signatureHelp", textDocument={"uri": "file:///a"}, position=place) is None


def test_a_document_whose_file_links_to_itself_is_checked(server: Server, project: Path) -> None:
    path, overlay = project / "desk.scene.yaml", project / "overlay.scene.yaml"
    path.symlink_to(path.name)
    overlay.symlink_to(overlay.name)
    server.open(path, BROKEN)
    assert [one["code"] for one in server.diagnostics(path)] == ["SF201"]
    server.open(overlay, "simfoundry: scene/1\nname: overlay\nextends: desk.scene.yaml\n")
    assert [one["code"] for one in server.diagnostics(overlay)] == ["SF203"]
    assert not [one for one in server.logged if one["type"] == 1]


def test_a_document_whose_name_no_file_can_have_is_checked(server: Server, project: Path) -> None:
    for name in ("a%00b.scene.yaml", f"{'a' * 5000}.scene.yaml"):
        uri = f"{project.as_uri()}/{name}"
        item = {"uri": uri, "languageId": "yaml", "version": 1, "text": BROKEN}
        server.tell("textDocument/didOpen", textDocument=item)
    path = project / "desk.scene.yaml"
    server.open(path, DESK)
    assert server.diagnostics(path) == []
    assert not [one for one in server.logged if one["type"] == 1]


def test_messages_before_the_start_do_not_prevent_it(project: Path) -> None:
    early = (
        b'{"jsonrpc": "2.0", "id": 1000, "method": "textDocument/hover", "params": {}}',
        b'{"jsonrpc": "2.0", "method": "textDocument/didClose", "params": {"textDocument": {"uri": "file:///a"}}}',
        b'{"jsonrpc": "2.0", "id": 1001, "method": "shutdown_", "params": {}}',
    )
    pipe = subprocess.PIPE
    with subprocess.Popen(COMMAND, cwd=project, stdin=pipe, stdout=pipe, stderr=subprocess.DEVNULL) as process:
        assert process.stdin is not None
        process.stdin.write(b"".join(map(framed, early)))
        with Server(process, project) as server:
            path = project / "desk.scene.yaml"
            server.open(path, BROKEN)
            assert [one["code"] for one in server.diagnostics(path)] == ["SF201"]
