"""The adapters to image and mesh models against a server on this machine that speaks their protocols.

No model is behind it: what is tested is what is sent, what is made of the answers, and how errors are said.
"""

from __future__ import annotations

import base64
import json
import threading
from collections.abc import Iterator
from email.message import EmailMessage
from email.parser import BytesParser
from email.policy import default
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest

from simfoundry.models.contract import ModelError
from simfoundry.models.generators import (
    HttpImages,
    HttpMeshes,
    images_from_environment,
    meshes_from_environment,
)
from simfoundry.models.transports.http import request_bytes

PICTURE = b"\x89PNG\r\n\x1a\nedited"
MESH = b"glTF\x02\x00\x00\x00made"


class Handler(BaseHTTPRequestHandler):
    """Answers and remembers."""

    seen: list[tuple[str, dict[str, str], bytes]]
    answer: tuple[int, bytes]

    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers["Content-Length"]))
        type(self).seen.append((self.path, dict(self.headers), body))
        status, data = type(self).answer
        self.send_response(status)
        self.send_header("Content-Length", str(len(data)))
        self.end_headers()
        self.wfile.write(data)

    def log_request(self, code: int | str = "-", size: int | str = "-") -> None:
        """Say nothing."""


@pytest.fixture
def server() -> Iterator[tuple[str, type[Handler]]]:
    own = type("Own", (Handler,), {"seen": [], "answer": (200, b"")})
    with ThreadingHTTPServer(("127.0.0.1", 0), own) as running:
        thread = threading.Thread(target=running.serve_forever, daemon=True)
        thread.start()
        yield f"http://127.0.0.1:{running.server_port}", own
        running.shutdown()
        thread.join()


def test_a_picture_is_edited(server: tuple[str, type[Handler]]) -> None:
    url, handler = server
    handler.answer = 200, json.dumps({"data": [{"b64_json": base64.b64encode(PICTURE).decode()}]}).encode()
    made = HttpImages(f"{url}/v1/", "painter", "secret").edit("a green mug", [PICTURE, b"\xff\xd8\xffscene"])
    assert made == PICTURE
    path, headers, body = handler.seen[0]
    assert path == "/v1/images/edits" and headers["Authorization"] == "Bearer secret"
    head = f"Content-Type: {headers['Content-Type']}\r\n\r\n".encode()
    message = BytesParser(policy=default).parsebytes(head + body)
    assert isinstance(message, EmailMessage)
    parts = [
        (p.get_param("name", header="content-disposition"), p.get_payload(decode=True)) for p in message.iter_parts()
    ]
    assert ("prompt", b"a green mug") in parts and ("model", b"painter") in parts
    assert ("background", b"transparent") in parts
    assert [data for name, data in parts if name == "image[]"] == [PICTURE, b"\xff\xd8\xffscene"]


def test_a_mesh_is_made(server: tuple[str, type[Handler]]) -> None:
    url, handler = server
    handler.answer = 200, MESH
    assert HttpMeshes(url).make(PICTURE, 7) == MESH
    path, _, body = handler.seen[0]
    asked = json.loads(body)
    assert path == "/generate" and base64.b64decode(asked["image"]) == PICTURE
    assert (asked["seed"], asked["type"], asked["texture"]) == (7, "glb", True)
    assert set(asked) == {"image", "seed", "texture", "face_count", "type"}
    HttpMeshes(url).make(PICTURE, 2**40 + 3)
    assert json.loads(handler.seen[1][2])["seed"] == 3, "servers refuse seeds of 2^32 and more"
    handler.answer = 404, b'{"text": "NETWORK ERROR", "error_code": 1}'
    with pytest.raises(ModelError, match=r"404 Not Found.*Hunyuan3D-2\.1 has no such option.*texture: false"):
        HttpMeshes(url).make(PICTURE, 7)
    with pytest.raises(ModelError, match=r"404 Not Found") as plain:
        HttpMeshes(url, texture=False).make(PICTURE, 7)
    assert "enable_tex" not in str(plain.value)


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        ((500, b"out of\nmemory"), "returned 500 Internal Server Error: out of memory"),
        ((200, b"{}"), "did not return an image in data"),
        ((200, b"not json"), "did not return an image in data"),
        ((200, b'{"data": [{"b64_json": "aGVsbG8="}]}'), "neither PNG nor JPEG"),
    ],
)
def test_bad_answers_are_said_in_a_sentence(
    server: tuple[str, type[Handler]], answer: tuple[int, bytes], said: str
) -> None:
    url, handler = server
    handler.answer = answer
    with pytest.raises(ModelError, match="the image model at") as error:
        HttpImages(url, "painter", "secret").edit("x", [PICTURE])
    assert said in str(error.value) and "secret" not in str(error.value) and "\n" not in str(error.value)


def test_what_is_no_mesh_and_what_is_too_large_is_refused(server: tuple[str, type[Handler]]) -> None:
    url, handler = server
    handler.answer = 200, b"<html>"
    with pytest.raises(ModelError, match="not a GLB"):
        HttpMeshes(url).make(PICTURE, 0)
    handler.answer = 200, b"x" * 2000
    with pytest.raises(ModelError, match="more than 0 MiB"):
        request_bytes("POST", url, "the mesh model", max_bytes=1000, json={})


def test_nobody_there_and_nothing_set_up() -> None:
    with pytest.raises(ModelError, match=r"the mesh model at .* did not respond .*is it running"):
        HttpMeshes("http://127.0.0.1:9", timeout_s=2).make(PICTURE, 0)
    with pytest.raises(ModelError, match="http:// or https://"):
        HttpMeshes("file:///etc").make(PICTURE, 0)
    with pytest.raises(ModelError, match="set SIMFOUNDRY_IMAGES_URL and SIMFOUNDRY_IMAGES_MODEL"):
        images_from_environment({})
    with pytest.raises(ModelError, match="set SIMFOUNDRY_MESHES_URL"):
        meshes_from_environment({})
    env = {"SIMFOUNDRY_IMAGES_URL": "http://a", "SIMFOUNDRY_IMAGES_MODEL": "m", "SIMFOUNDRY_MESHES_URL": "http://b"}
    assert (
        images_from_environment(env) == HttpImages("http://a", "m") and meshes_from_environment(env).url == "http://b"
    )
    assert images_from_environment({"SIMFOUNDRY_IMAGES_URL": "http://a"}, "mine") == HttpImages("http://a", "mine")
    with pytest.raises(ModelError, match="PNG or JPEG"):
        HttpImages("http://127.0.0.1:9", "m").edit("x", [b"GIF89a"])
    with pytest.raises(ModelError, match="requires an image"):
        HttpImages("http://127.0.0.1:9", "m").edit("x", [])
