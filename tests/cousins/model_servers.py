"""Servers on this machine that answer as the models of the object axis do, from a recorded exchange.

``recorded/models.json`` holds the answers of the vision-language model, in the types of the paper's prompts, by a part
of the prompt that they answer. They were written by hand, for no model was asked: what is shown is what is sent, and
what becomes of the answers. The image model gives the picture back that it should edit; the mesh model makes a
cylinder, each wider than the last.
"""

from __future__ import annotations

import base64
import json
import re
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from email.message import EmailMessage
from email.parser import BytesParser
from email.policy import default
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

RECORDED = Path(__file__).parent / "recorded" / "models.json"


class Models(BaseHTTPRequestHandler):
    """The three models on one port: what they were asked is in ``asked``, by path."""

    asked: list[tuple[str, str]]
    answers: list[dict[str, Any]]
    down: frozenset[str]

    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers["Content-Length"]))
        if self.path in self.down:
            self._answer(400, b"no such model")
        elif self.path == "/v1/chat/completions":
            self._answer(200, self._said(json.loads(body)))
        elif self.path == "/v1/images/edits":
            self._answer(200, self._edited(body))
        else:
            self._answer(200, self._made(json.loads(body)))

    def _said(self, asked: dict[str, Any]) -> bytes:
        content = asked["messages"][-1]["content"]
        prompt = next(part["text"] for part in content if part["type"] == "text")
        pictures = sum(part["type"] == "image_url" for part in content)
        self.asked.append((self.path, f"{pictures} {prompt}"))
        row = next(row for row in self.answers if re.search(row["prompt"], prompt))
        message = {"role": "assistant", "content": json.dumps(row["answer"])}
        choice = {"index": 0, "finish_reason": "stop", "message": message}
        whole = {"id": "1", "object": "chat.completion", "created": 1, "model": asked["model"], "choices": [choice]}
        return json.dumps(whole).encode()

    def _edited(self, body: bytes) -> bytes:
        head = f"Content-Type: {self.headers['Content-Type']}\r\n\r\n".encode()
        message = BytesParser(policy=default).parsebytes(head + body)
        assert isinstance(message, EmailMessage)
        parts = [(p.get_param("name", header="content-disposition"), p) for p in message.iter_parts()]
        fields = {str(name): p.get_payload(decode=True) for name, p in parts if name != "image[]"}
        (first, *_) = (p.get_payload(decode=True) for name, p in parts if name == "image[]")
        self.asked.append((self.path, f"{fields['model'].decode()}: {fields['prompt'].decode()}"))  # type: ignore[union-attr]
        return json.dumps({"data": [{"b64_json": base64.b64encode(first).decode()}]}).encode()  # type: ignore[arg-type]

    def _made(self, asked: dict[str, Any]) -> bytes:
        import numpy as np
        import trimesh

        picture = base64.b64decode(asked["image"])
        self.asked.append((self.path, f"{picture[1:4].decode()} {asked['texture']}"))
        size = 0.3 + 0.05 * sum(path == self.path for path, _ in self.asked)
        mesh = trimesh.creation.cylinder(radius=size, height=1.0, sections=24)
        mesh.apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2, (1, 0, 0)))  # y up, as GLB has it
        data = mesh.export(file_type="glb")
        assert isinstance(data, bytes)
        return data

    def _answer(self, status: int, data: bytes) -> None:
        self.send_response(status)
        self.send_header("Content-Type", "application/json")
        self.send_header("Content-Length", str(len(data)))
        self.end_headers()
        self.wfile.write(data)

    def log_message(self, *args: object) -> None:
        """Say nothing."""


@contextmanager
def served(down: frozenset[str] = frozenset()) -> Iterator[tuple[str, type[Models]]]:
    """The address of the servers, and what they hear; paths that are ``down`` answer with an error."""
    own = type("Own", (Models,), {"asked": [], "answers": json.loads(RECORDED.read_text()), "down": down})
    with ThreadingHTTPServer(("127.0.0.1", 0), own) as running:
        thread = threading.Thread(target=running.serve_forever, daemon=True)
        thread.start()
        yield f"http://127.0.0.1:{running.server_port}", own
        running.shutdown()
        thread.join()
