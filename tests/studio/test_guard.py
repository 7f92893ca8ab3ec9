"""Who may connect to a studio."""

from __future__ import annotations

import http.client
from collections.abc import Iterator
from pathlib import Path

import pytest

from simfoundry.errors import SimfoundryError
from simfoundry.studio.guard import ConnectionGuard
from simfoundry.studio.server import StudioServer
from simfoundry.studio.view.panels.document import diff_html
from simfoundry.studio.view.panels.panel import set_value

TOKEN = "0123456789abcdef"


@pytest.mark.parametrize(
    ("token", "path", "headers", "is_accepted"),
    [
        ("", "/", {"Host": "localhost:8080"}, True),
        ("", "/", {"Host": "127.0.0.1:8080"}, True),
        ("", "/", {"Host": "[::1]:8080", "Origin": "http://[::1]:8080"}, True),
        ("", "/", {}, False),
        ("", "/", {"Host": "localhost.evil.com"}, False),
        ("", "/", {"Host": "localhost:8080", "Origin": "http://evil.com"}, False),
        ("", "/", {"Host": "localhost:8080", "Origin": "http://localhost:9"}, False),
        ("", "/", {"Host": "localhost:8080", "Origin": "null"}, False),
        (TOKEN, "/", {"Host": "lab.org"}, False),
        (TOKEN, f"/?token={TOKEN}", {"Host": "lab.org"}, True),
        (TOKEN, f"/?token={TOKEN}0", {"Host": "lab.org"}, False),
        (TOKEN, "/?token=%FF", {"Host": "lab.org"}, False),
        (TOKEN, "/", {"Host": "lab.org", "Cookie": f"a=b; simfoundry_studio={TOKEN}"}, True),
        (TOKEN, "/", {"Host": "lab.org", "Cookie": "simfoundry_studio=guess"}, False),
        (TOKEN, "/", {"Host": "lab.org", "Cookie": "\x00;=;"}, False),
        (TOKEN, f"/?token={TOKEN}", {"Host": "lab.org", "Origin": "http://evil.com"}, False),
    ],
)
def test_only_those_who_may_are_accepted(token: str, path: str, headers: dict[str, str], is_accepted: bool) -> None:
    reason = ConnectionGuard(token).refusal(path, headers)
    assert (reason == "") is is_accepted, reason


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[StudioServer]:
    """A studio that needs a token."""
    pytest.importorskip("viser")
    path: Path = tmp_path_factory.mktemp("guarded") / "a.scene.yaml"
    path.write_text("simfoundry: scene/1\nname: a\nobjects:\n  ball: {shape: {sphere: 0.1}, mass: 1}\n")
    with StudioServer(path, port=0, token=TOKEN) as running:
        yield running


def _status(server: StudioServer, path: str, headers: dict[str, str]) -> tuple[int, str]:
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=10)
    connection.request("GET", path, headers=headers)
    answer = connection.getresponse()
    return answer.status, answer.headers.get("Set-Cookie", "")


UPGRADE = {
    "Connection": "Upgrade", "Upgrade": "websocket", "Sec-WebSocket-Version": "13",
    "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==", "Sec-WebSocket-Protocol": "viser-v1.1.1",
}  # fmt: skip


@pytest.mark.parametrize("token", ["short", "0123456789abcde;", "0123456789abcde&x=1", "0123456789abcdef\n"])
def test_a_token_that_could_be_guessed_or_misread_is_refused(token: str, tmp_path: Path) -> None:
    with pytest.raises(SimfoundryError, match="at least 16 letters"):
        StudioServer(tmp_path / "a.scene.yaml", port=0, token=token)


def test_texts_of_documents_are_not_run_by_the_browser(server: StudioServer) -> None:
    handle = server.viser.gui.add_markdown("")
    set_value(handle, 'unknown key `<img src=x onerror="alert(1)">` ![](http://example.org/a.png)')
    assert "<" not in handle.content and "![" not in handle.content
    assert "&lt;script&gt;" in diff_html("+  # <script>alert(1)</script>\n")


def test_pages_and_connections_need_the_token(server: StudioServer) -> None:
    assert _status(server, "/", {})[0] == 403
    assert _status(server, "/", UPGRADE)[0] == 403
    status, cookie = _status(server, f"/?token={TOKEN}", {})
    assert status == 200 and cookie == f"simfoundry_studio={TOKEN}; HttpOnly; SameSite=Strict; Path=/"
    assert _status(server, "/", {"Cookie": f"simfoundry_studio={TOKEN}"})[0] == 200
    assert _status(server, "/", {**UPGRADE, "Cookie": f"simfoundry_studio={TOKEN}"})[0] == 101
    assert _status(server, f"/../../etc/passwd?token={TOKEN}", {})[0] == 404
    assert server.address == f"http://localhost:{server.port}/?token={TOKEN}"
