"""Servers and processes that die, hang, lie or drown the client: one sentence, and nothing left half-written."""

from __future__ import annotations

import json
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scaffold import Model, Result

from simfoundry.models.client import ModelClient
from simfoundry.models.contract import ModelError
from simfoundry.models.transports import http, process
from simfoundry.models.transports.http import HttpTransport
from simfoundry.models.transports.process import ProcessTransport
from simfoundry.models.transports.recorded import RecordedTransport
from simfoundry.models.wire import ANSWER, Bundle, read_bundle, write_bundle
from tests.models import truth
from tests.models.test_tasks import CALLS, Direct, serving

Reply = Callable[[socket.socket], None]


@contextmanager
def talking(reply: Reply) -> Iterator[tuple[str, list[bytes]]]:
    """Serve connections with a function that writes to the socket, after the request was read."""
    seen: list[bytes] = []
    with socket.create_server(("127.0.0.1", 0)) as listening:
        listening.settimeout(5)

        def serve() -> None:
            while True:
                try:
                    connection, _ = listening.accept()
                except OSError:
                    return
                with connection:
                    connection.settimeout(2)
                    try:
                        seen.append(_request(connection))
                        reply(connection)
                    except OSError:
                        pass  # the client gave up on the reply, as the test expects

        threading.Thread(target=serve, daemon=True).start()
        yield f"http://127.0.0.1:{listening.getsockname()[1]}", seen


def _request(connection: socket.socket) -> bytes:
    data = b""
    while b"\r\n\r\n" not in data:
        data += connection.recv(65536)
    head, _, body = data.partition(b"\r\n\r\n")
    length = next((int(line[15:]) for line in head.lower().split(b"\r\n") if line.startswith(b"content-length:")), 0)
    while len(body) < length:
        body += connection.recv(65536)
    return head + b"\r\n\r\n" + body


def _says(status: str, body: bytes = b"", *headers: str) -> Reply:
    lines = [f"HTTP/1.1 {status}", f"Content-Length: {len(body)}", "Connection: close", *headers]
    return lambda connection: connection.sendall("\r\n".join(lines).encode() + b"\r\n\r\n" + body)


def _dies(connection: socket.socket) -> None:
    connection.sendall(b"HTTP/1.1 200 OK\r\nContent-Length: 1000\r\n\r\nPK")


def _hangs(connection: socket.socket) -> None:
    connection.recv(1)  # until the client gives up


def _drips(connection: socket.socket) -> None:
    connection.sendall(b"HTTP/1.1 200 OK\r\nContent-Length: 100000\r\n\r\n")
    for _ in range(200):
        connection.sendall(b"P")
        time.sleep(0.02)


def _pours(connection: socket.socket) -> None:
    connection.sendall(b"HTTP/1.1 200 OK\r\nConnection: close\r\n\r\n")
    while True:
        connection.sendall(bytes(2**16))


def _nan(_: Bundle) -> Result:
    return Result({"depth": np.full((48, 64), np.nan, np.float32)})


PROBLEM = json.dumps({"title": "the model failed", "detail": "CUDA out\nof memory", "status": 500}).encode()
FAULTS: dict[str, tuple[Reply, str]] = {
    "dies": (_dies, "did not respond .*is it running"),
    "hangs": (_hangs, "did not respond within 0.5 s"),
    "drips": (_drips, "did not finish its response within 0.5 s"),
    "pours": (_pours, "more than 1 MiB"),
    "2 GB mesh": (lambda c: c.sendall(b"HTTP/1.1 200 OK\r\nContent-Length: 2147483648\r\n\r\n"), "more than 1 MiB"),
    "no bundle": (_says("200 OK", b"<html>hello</html>"), "is not a valid ZIP file"),
    "problem": (_says("500 Oops", PROBLEM, "Content-Type: application/problem+json"), "500 Oops: CUDA out of memory$"),
    "list as problem": (_says("500 Oops", b"[1]"), r"500 Oops: \[1\]$"),
    "silent": (_says("404 Not Found"), "404 Not Found: no explanation"),
    "redirects": (_says("307 Moved", b"", "Location: http://127.0.0.1:9/"), "redirections are not followed"),
    "strange job": (_says("202 Accepted", b'{"job": "../../secrets"}'), "not a plain name"),
    "no job": (_says("202 Accepted", b"later"), "damaged description of a job"),
    "a negative length": (lambda c: c.sendall(b"HTTP/1.1 200 OK\r\nContent-Length: many\r\n\r\n"), "did not respond"),
    "another language": (lambda c: c.sendall(b"SSH-2.0-OpenSSH_9.2\r\n"), "did not respond"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_faulty_server_is_reported_in_one_sentence(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(http, "PAUSES_S", (0.0,))
    monkeypatch.setattr(http.request_bytes, "__defaults__", (5.0, 2**20))
    reply, said = FAULTS[name]
    with talking(reply) as (url, seen):
        limit_s = 0.5 if name in ("hangs", "drips") else 10.0
        client = ModelClient(HttpTransport(url, "s3cret", limit_s), record=tmp_path)
        with pytest.raises(ModelError, match=said) as error:
            CALLS["depth"](client)
    text = str(error.value)
    assert "\n" not in text and "s3cret" not in text and not list(tmp_path.iterdir())
    assert b"Bearer s3cret" in seen[0]


def test_a_request_is_repeated_while_a_server_starts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(http, "PAUSES_S", (0.0, 0.0))
    answers = iter([_says("503 Loading"), _dies, _says("200 OK", truth.TRUTH.answer(_depth_request()))])
    with talking(lambda connection: next(answers)(connection)) as (url, seen):
        assert CALLS["depth"](ModelClient(HttpTransport(url))).made_by.name == "truth"
    keys = {line for one in seen for line in one.lower().split(b"\r\n") if line.startswith(b"idempotency-key")}
    assert len(seen) == 3 and len(keys) == 1


def _depth_request() -> bytes:
    sent: list[bytes] = []

    class Catch(Direct):
        def exchange(self, task: str, digest: str, data: bytes) -> bytes:
            sent.append(data)
            return super().exchange(task, digest, data)

    CALLS["depth"](ModelClient(Catch(truth.TRUTH)))
    return sent[0]


def test_a_slow_model_answers_as_a_job(monkeypatch: pytest.MonkeyPatch) -> None:
    import scaffold

    monkeypatch.setattr(scaffold, "SYNCHRONOUS_S", 0.0)
    monkeypatch.setattr(http, "POLL_S", (0.02, 0.02))
    calls: list[int] = []

    def slow(request: Bundle) -> Result:
        calls.append(1)
        time.sleep(0.1)
        return truth.depth(request)

    with serving(Model(truth.IDENTITY, {"depth": slow})) as url:
        client = ModelClient(HttpTransport(url, timeout_s=5))
        assert CALLS["depth"](client).made_by.name == "truth"
        CALLS["depth"](client)
        assert len(calls) == 1, "an equal request is answered by the finished job"

    def slower(request: Bundle) -> Result:
        time.sleep(1.5)
        return truth.depth(request)

    with serving(Model(truth.IDENTITY, {"depth": slower})) as url:
        late = ModelClient(HttpTransport(url, timeout_s=0.6))
        with pytest.raises(ModelError, match=r"did not finish its job within 0\.6 s"):
            CALLS["depth"](late)


def test_a_model_that_fails_is_quoted_and_asked_again() -> None:
    fails = [True]

    def solve(request: Bundle) -> Result:
        if fails.pop() if fails else False:
            raise RuntimeError("CUDA out of memory\nTried to allocate 20 GiB")
        return truth.depth(request)

    with serving(Model(truth.IDENTITY, {"depth": solve})) as url:
        client = ModelClient(HttpTransport(url))
        with pytest.raises(ModelError, match=r"500 .*RuntimeError: CUDA out of memory Tried to allocate 20 GiB"):
            CALLS["depth"](client)
        assert CALLS["depth"](client).made_by.name == "truth"
        with pytest.raises(ModelError, match=r"404 .*this server solves depth"):
            CALLS["segment"](client)


def test_a_token_is_required_and_never_shown() -> None:
    with serving(truth.TRUTH, token="right") as url:
        assert CALLS["depth"](ModelClient(HttpTransport(url, "right"))).made_by.name == "truth"
        for token in ("", "wrong"):
            with pytest.raises(ModelError, match=r"401 .*missing or wrong") as error:
                CALLS["depth"](ModelClient(HttpTransport(url, token)))
            assert "right" not in str(error.value)
            with pytest.raises(ModelError, match="401"):
                HttpTransport(url, token).describe()
    shown = HttpTransport("http://user:pass@host:1/").place
    assert shown == "http://host:1"


def _python(code: str) -> tuple[str, ...]:
    return (sys.executable, "-S", "-c", f"import os, sys, time\n{code}")


PROCESSES: dict[str, tuple[tuple[str, ...], str]] = {
    "absent": (("/nonexistent/python", "serve.py"), "could not be started"),
    "fails": (_python("sys.exit('no CUDA device')"), "exited with code 1; its last output was: no CUDA device"),
    "crashes": (_python("os.kill(os.getpid(), 11)"), "crashed .SIGSEGV."),
    "silent": (_python("sys.stdin.buffer.read()"), "wrote no answer"),
    "hangs": (_python("sys.stdin.buffer.read(); time.sleep(60)"), "did not answer within 1 s"),
    "pours": (_python("while True: os.write(1, bytes(65536))"), "wrote more than 0 MiB"),
    "chats": (_python("print('loading weights')"), "is not a valid ZIP file"),
    "deaf": (_python("os.close(0); print('x')"), "is not a valid ZIP file"),
}


@pytest.mark.parametrize("name", PROCESSES)
def test_a_faulty_process_is_reported_in_one_sentence(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    command, said = PROCESSES[name]
    monkeypatch.setattr(process, "MAX_BUNDLE_BYTES", 2**19)
    with pytest.raises(ModelError, match=said) as error:
        CALLS["depth"](ModelClient(ProcessTransport(command, timeout_s=1.0), record=tmp_path))
    assert "\n" not in str(error.value) and not list(tmp_path.iterdir())


def test_the_children_of_a_hanging_process_are_ended(tmp_path: Path) -> None:
    child = tmp_path / "child"
    code = f"import subprocess\np = subprocess.Popen(['sleep', '60'])\nopen({str(child)!r}, 'w').write(str(p.pid))"
    with pytest.raises(ModelError, match="did not answer within"):
        ProcessTransport(_python(f"{code}\ntime.sleep(60)"), timeout_s=1.0).exchange("depth", "0", b"")
    deadline = time.monotonic() + 2
    while time.monotonic() < deadline and _runs(int(child.read_text())):
        time.sleep(0.02)
    assert not _runs(int(child.read_text()))


def _runs(number: int) -> bool:
    try:
        return " Z " not in Path(f"/proc/{number}/stat").read_text()
    except OSError:
        return False


def test_only_good_answers_are_recorded_and_records_are_checked(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="not finite"):
        CALLS["depth"](ModelClient(Direct(Model(truth.IDENTITY, {"depth": _nan})), record=tmp_path))
    assert not list(tmp_path.iterdir())
    CALLS["depth"](ModelClient(Direct(truth.TRUTH), record=tmp_path))
    (kept,) = tmp_path.iterdir()
    answer = read_bundle(kept.read_bytes(), ANSWER)
    dead = ModelClient(HttpTransport("http://127.0.0.1:9", timeout_s=1), record=tmp_path)
    assert CALLS["depth"](dead).made_by.name == "truth", "a recorded answer needs no server"
    with pytest.raises(ModelError, match=r"contains no answer to this request for `segment` \([0-9a-f]{12}…\)"):
        CALLS["segment"](ModelClient(RecordedTransport(tmp_path)))
    kept.write_bytes(write_bundle(Bundle({**answer.head, "request": "0" * 64}, answer.members), ANSWER))
    with pytest.raises(ModelError, match=rf"from {kept} belongs to another request"):
        CALLS["depth"](ModelClient(RecordedTransport(tmp_path), record=tmp_path))
    kept.write_bytes(kept.read_bytes()[:100])
    with pytest.raises(ModelError, match="is not a valid ZIP file"):
        CALLS["depth"](ModelClient(RecordedTransport(tmp_path)))
    with pytest.raises(ModelError, match="contains no recorded answers"):
        RecordedTransport(tmp_path / "nothing").describe()


@pytest.mark.parametrize(
    "identity", [None, {}, {"name": "x", "version": "1"}, {"name": "x", "version": 3, "licence": "y"}, "x"]
)
def test_an_answer_must_say_which_model_made_it(identity: Any) -> None:
    class Nameless(Direct):
        def exchange(self, task: str, digest: str, data: bytes) -> bytes:
            answer = read_bundle(super().exchange(task, digest, data), ANSWER)
            return write_bundle(Bundle({**answer.head, "model": identity}, answer.members), ANSWER)

    with pytest.raises(ModelError, match="does not state which model made it"):
        CALLS["depth"](ModelClient(Nameless(truth.TRUTH)))
