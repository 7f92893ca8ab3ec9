"""A small client of the language server protocol over standard input and output, as an editor has one."""

from __future__ import annotations

import json
import queue
import subprocess
import threading
from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Self

Message = dict[str, Any]
PATIENCE = 60.0
"""Seconds that an answer may take on a loaded machine."""

CAPABILITIES = {
    "textDocument": {
        "completion": {"completionItem": {"snippetSupport": True, "documentationFormat": ["markdown", "plaintext"]}},
        "hover": {"contentFormat": ["markdown", "plaintext"]},
        "publishDiagnostics": {"relatedInformation": True},
    },
    "workspace": {"configuration": True, "workspaceFolders": True},
}
"""What VS Code and Neovim say of themselves, as far as the server asks."""

SETTINGS = {
    "yaml": {
        "validate": True,
        "hover": True,
        "completion": True,
        "format": {"enable": False},
        "schemaStore": {"enable": False},  # the schemas of others are on the network, and none is for these files
    }
}


@dataclass
class Server:
    """A running server and what it said; documents are known by their path."""

    process: subprocess.Popen[bytes]
    folder: Path
    options: Message = field(default_factory=dict)
    answers: dict[int, queue.Queue[Message]] = field(default_factory=dict)
    published: defaultdict[str, queue.Queue[Message]] = field(default_factory=lambda: defaultdict(queue.Queue))
    logged: list[Message] = field(default_factory=list)
    notices: dict[str, queue.Queue[Message]] = field(default_factory=dict)
    count: int = 0
    writing: threading.Lock = field(default_factory=threading.Lock)

    def __post_init__(self) -> None:
        threading.Thread(target=self._listen, daemon=True).start()
        answer = self.ask(
            "initialize",
            processId=None,
            rootUri=self.folder.as_uri(),
            workspaceFolders=[{"uri": self.folder.as_uri(), "name": self.folder.name}],
            capabilities=CAPABILITIES,
            initializationOptions=self.options,
        )
        self.capabilities: Message = answer["capabilities"]
        self.tell("initialized")
        self.tell("workspace/didChangeConfiguration", settings=SETTINGS)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: type[BaseException] | BaseException | TracebackType | None) -> None:
        try:
            self.ask("shutdown")
            self.tell("exit")
            self.process.wait(10)
        finally:
            self.process.kill()
            self.process.wait()

    def ask(self, method: str, /, **params: Any) -> Any:
        """The result of a request."""
        self.count += 1
        answer = self.answers[self.count] = queue.Queue()
        self._send({"id": self.count, "method": method, "params": params})
        message = answer.get(timeout=PATIENCE)
        if "error" in message:
            raise RuntimeError(f"{method}: {message['error']}")
        return message["result"]

    def tell(self, method: str, /, **params: Any) -> None:
        """Send a notification."""
        self._send({"method": method, "params": params})

    def open(self, path: Path, text: str) -> None:
        """Open a document."""
        self.published[path.as_uri()] = queue.Queue()
        document = {"uri": path.as_uri(), "languageId": "yaml", "version": 1, "text": text}
        self.tell("textDocument/didOpen", textDocument=document)

    def diagnostics(self, path: Path) -> list[Message]:
        """What the server says of a document that was opened, once it does."""
        found: list[Message] = self.published[path.as_uri()].get(timeout=PATIENCE)["diagnostics"]
        return found

    def diagnostics_of(self, path: Path, version: int) -> list[Message]:
        """What the server says of a version of a document, once it does."""
        while True:
            message = self.published[path.as_uri()].get(timeout=PATIENCE)
            if message.get("version") == version:
                found: list[Message] = message["diagnostics"]
                return found

    def change(self, path: Path, text: str, **range_: Message) -> int:
        """Replace the text of a document, or the part between the positions ``start`` and ``end``.

        Returns the new version.
        """
        self.count += 1
        changes = [{"text": text, **({"range": range_} if range_ else {})}]
        document = {"uri": path.as_uri(), "version": self.count}
        self.tell("textDocument/didChange", textDocument=document, contentChanges=changes)
        return self.count

    def notice(self, method: str) -> Message:
        """The next notification of a kind, once the server sends it."""
        return self.notices.setdefault(method, queue.Queue()).get(timeout=PATIENCE)

    def ask_about(self, method: str, path: Path, /, **params: Any) -> Any:
        """The result of a request about a document."""
        return self.ask(method, textDocument={"uri": path.as_uri()}, **params)

    def close(self, path: Path) -> None:
        """Close a document."""
        self.tell("textDocument/didClose", textDocument={"uri": path.as_uri()})

    def last_diagnostics(self, path: Path, code: str = "") -> list[Message]:
        """What the server says of a document in the end: a finding with a code, or nothing."""
        while True:
            found = self.diagnostics(path)
            if [one["code"] for one in found][:1] == ([code] if code else []):
                return found

    def completions(self, path: Path, line: int, character: int) -> list[Message]:
        """What is offered at a place, counted from 0."""
        answer = self.ask("textDocument/completion", **_place(path, line, character))
        items: list[Message] = answer if isinstance(answer, list) else (answer or {}).get("items", [])
        return items

    def hover(self, path: Path, line: int, character: int) -> str:
        """What is shown at a place, counted from 0, as Markdown; empty where nothing is."""
        answer = self.ask("textDocument/hover", **_place(path, line, character))
        return _markdown(answer["contents"]) if answer else ""

    def _send(self, message: Message) -> None:
        self.send_bytes(framed(json.dumps({"jsonrpc": "2.0", **message}).encode()))

    def send_bytes(self, data: bytes) -> None:
        """Send bytes as they are, whether they are a message or not."""
        pipe = self.process.stdin
        assert pipe is not None
        with self.writing:
            pipe.write(data)
            pipe.flush()

    def _listen(self) -> None:
        assert self.process.stdout is not None
        for message in _messages(self.process.stdout):
            match message:
                case {"id": number, "method": method}:
                    self._send({"id": number, "result": _settings(method, message.get("params"))})
                case {"id": number}:
                    self.answers.pop(number, queue.Queue()).put(message)
                case {"method": "textDocument/publishDiagnostics", "params": {"uri": uri} as params}:
                    self.published[uri].put(params)
                case {"method": "window/logMessage" | "window/showMessage", "params": params}:
                    self.logged.append(params)
                case {"method": method}:
                    self.notices.setdefault(method, queue.Queue()).put(message.get("params") or {})


def framed(body: bytes) -> bytes:
    """The bytes of a message, after a header with their number."""
    return b"Content-Length: %d\r\n\r\n%s" % (len(body), body)


def _place(path: Path, line: int, character: int) -> Message:
    return {"textDocument": {"uri": path.as_uri()}, "position": {"line": line, "character": character}}


def _markdown(contents: Any) -> str:
    return str(contents["value"] if isinstance(contents, dict) else contents)


def _settings(method: str, params: Any) -> Any:
    """The answer to what a server asks of an editor."""
    if method == "workspace/configuration":
        return [SETTINGS.get(item.get("section", "")) for item in params["items"]]
    return None


def _messages(stream: IO[bytes]) -> Iterator[Message]:
    """Each message of a stream, framed by its length."""
    while header := stream.readline():
        length = 0
        while header.strip():
            name, _, value = header.partition(b":")
            if name.lower() == b"content-length":
                length = int(value)
            header = stream.readline()
        yield json.loads(stream.read(length))


@contextmanager
def started(
    command: Sequence[str],
    folder: Path,
    errors: int | IO[bytes] = subprocess.DEVNULL,
    options: Message | None = None,
) -> Iterator[Server]:
    """A server that has a folder open, and that writes its standard error to ``errors``."""
    with (
        subprocess.Popen(command, cwd=folder, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors) as process,
        Server(process, folder, options or {}) as server,
    ):
        yield server
