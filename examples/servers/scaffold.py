"""Serve one model as ``bundle/1``: over HTTP, and on standard input and output.

Copy this file, `simfoundry/models/wire.py` and one of the servers beside it into the environment of the model, which
needs numpy and Pillow but not SimFoundry. Then:

    python serve_sam3.py --port 8301                 # HTTP; SIMFOUNDRY_SERVER_TOKEN sets a bearer token
    python serve_sam3.py < request.zip > answer.zip  # one request
    python serve_sam3.py --describe                  # tasks, model and licence
"""

from __future__ import annotations

import argparse
import hmac
import json
import os
import sys
import threading
import time
import traceback
import uuid
from collections import OrderedDict
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures import TimeoutError as FutureTimeoutError
from dataclasses import dataclass
from dataclasses import field as dataclass_field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

try:
    from simfoundry.models import wire
except ImportError:  # in the environment of a model, where wire.py lies beside this file
    import wire  # type: ignore[import-not-found,no-redef]

BundleFile = wire.BundleFile
BundleImage = wire.BundleImage

__all__ = ["BundleFile", "BundleImage", "Model", "RefusedError", "Result", "run", "serve"]

KEPT = 16  # Number of finished jobs whose answers are kept, so that a repeated request costs nothing

SYNCHRONOUS_S = 20.0  # Time after which a request becomes a job [s], below the timeout of common proxies


class RefusedError(ValueError):
    """Raise this for a request that the model cannot solve; the message is shown to the user."""


@dataclass
class Result:
    """The answer of a model.

    Attributes:
        members: Arrays, images and files by name.
        notes: Units and frames of members, by name: ``{"depth": {"unit": "m", "frame": "camera_opencv"}}``.
        values: Results that are not arrays.
        confidence: Confidence in the whole answer, 0 to 1.
        warnings: Remarks for the user.
    """

    members: dict[str, wire.Content] = dataclass_field(default_factory=dict)
    notes: dict[str, dict[str, str]] = dataclass_field(default_factory=dict)
    values: dict[str, Any] | None = None
    confidence: float | None = None
    warnings: tuple[str, ...] = ()


Solve = Callable[[wire.Bundle], Result]


@dataclass
class Model:
    """A model, and the tasks that it solves.

    ``identity`` contains ``name``, ``version``, ``licence``, ``commercial`` and, if they are known, ``weights_sha256``.
    Functions that solve tasks are called one at a time; they load the weights when they are first called.
    """

    identity: Mapping[str, Any]
    tasks: Mapping[str, Solve]

    def describe(self) -> dict[str, Any]:
        """Return the content of ``GET /v1``."""
        tasks = {name: {"model": dict(self.identity)} for name in self.tasks}
        return {"bundle": wire.VERSION, "tasks": tasks, "limits": {"bytes": wire.MAX_BUNDLE_BYTES}}

    def answer(self, data: bytes, task: str | None = None) -> bytes:
        """Return the answer to a request, both as bundles.

        Raises:
            wire.BundleError: If the request is damaged.
            RefusedError: If the request cannot be solved.
        """
        request = wire.read_bundle(data, wire.REQUEST)
        named = str(request.head.get("task"))
        if task is not None and named != task:
            raise RefusedError(f"the request is for `{named}`, but was sent to /v1/{task}")
        if named not in self.tasks:
            raise RefusedError(f"this server solves {', '.join(self.tasks)}, not `{named}`")
        started = time.monotonic()
        result = self.tasks[named](request)
        head: dict[str, Any] = {
            "bundle": wire.VERSION, "task": named, "request": request.digest, "model": dict(self.identity),
            "seconds": round(time.monotonic() - started, 3), "warnings": list(result.warnings),
        }  # fmt: skip
        head.update({} if result.values is None else {"values": result.values})
        head.update({} if result.confidence is None else {"confidence": float(result.confidence)})
        return wire.write_bundle(wire.Bundle(head, result.members, result.notes), wire.ANSWER)


def run(model: Model, arguments: list[str] | None = None) -> int:
    """Serve a model as the command line says. Returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--host", default="127.0.0.1", help="Address to listen on.")
    parser.add_argument("--port", type=int, help="Port of the HTTP server. Without it, one request is answered.")
    parser.add_argument("--describe", action="store_true", help="Print the tasks, the model and its licence.")
    given = parser.parse_args(arguments)
    if given.describe:
        print(json.dumps(model.describe(), indent=1))
        return 0
    if given.port is not None:
        serve(model, given.host, given.port).serve_forever()
        return 0
    output = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # libraries print to standard output
    try:
        answer = model.answer(sys.stdin.buffer.read(wire.MAX_BUNDLE_BYTES + 1))
    except (wire.BundleError, RefusedError) as error:
        print(f"the request was refused: {error}", file=sys.stderr)
        return 2
    except Exception as error:  # a model can raise anything; the last line of the log is shown to the user
        traceback.print_exc()
        print(_sentence(error), file=sys.stderr)
        return 1
    output.write(answer)
    output.close()
    return 0


def _sentence(error: BaseException) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())[:300]


class Jobs:
    """Requests in progress and finished ones. The model works on one at a time."""

    def __init__(self, model: Model) -> None:
        self._model, self._lock = model, threading.Lock()
        self._worker = ThreadPoolExecutor(max_workers=1)
        self._jobs: OrderedDict[str, Future[bytes]] = OrderedDict()

    def submit(self, task: str, data: bytes, key: str) -> tuple[str, Future[bytes]]:
        """Start a job, or return the one with the same idempotency key."""
        name = f"{task}-{key[:32]}" if key and all(c in "0123456789abcdef" for c in key) else uuid.uuid4().hex
        with self._lock:
            known = self._jobs.get(name)
            if known is None or (known.done() and (known.cancelled() or known.exception() is not None)):
                known = self._jobs[name] = self._worker.submit(self._model.answer, data, task)
            self._jobs.move_to_end(name)
            finished = [other for other, job in self._jobs.items() if job.done()]
            for other in finished[:-KEPT]:
                del self._jobs[other]
        return name, known

    def find(self, name: str) -> Future[bytes] | None:
        """Return a job."""
        with self._lock:
            return self._jobs.get(name)

    def cancel(self, name: str) -> None:
        """Cancel a job that has not started, and forget it."""
        with self._lock:
            job = self._jobs.pop(name, None)
        if job is not None:
            job.cancel()


def serve(model: Model, host: str, port: int, token: str | None = None) -> ThreadingHTTPServer:
    """Return an HTTP server for a model. Call its ``serve_forever``."""
    secret = os.environ.get("SIMFOUNDRY_SERVER_TOKEN", "") if token is None else token
    jobs = Jobs(model)
    handler = type("ModelHandler", (_Handler,), {"model": model, "jobs": jobs, "secret": secret})
    server = ThreadingHTTPServer((host, port), handler)
    server.daemon_threads = True
    return server


class _Handler(BaseHTTPRequestHandler):
    model: Model
    jobs: Jobs
    secret: str
    protocol_version = "HTTP/1.1"
    timeout = 60.0  # [s] for a client that sends nothing

    def do_GET(self) -> None:
        """Describe the server, or return the state of a job."""
        if self.path == "/health":
            self._json(200, {"status": "ok"})
        elif not self._allowed():
            return
        elif self.path == "/v1":
            self._json(200, self.model.describe())
        elif self.path.startswith("/v1/jobs/"):
            name = self.path.rpartition("/")[2]
            job = self.jobs.find(name)
            if job is None:
                self._problem(404, "unknown job", "there is no such job; it may have been forgotten")
            else:
                self._finish(name, job, 0.0)
        else:
            self._problem(404, "unknown address", "the addresses are /v1, /v1/{task} and /v1/jobs/{job}")

    def do_POST(self) -> None:
        """Solve a task."""
        length = self.headers.get("Content-Length", "")
        if not length.isdigit() or int(length) > wire.MAX_BUNDLE_BYTES:
            self.close_connection = True
            self._problem(
                413, "too large", f"a request has at most {wire.MAX_BUNDLE_BYTES} bytes and states its length"
            )
            return
        if not self._allowed():
            self.close_connection = True  # the body is not read
            return
        data = self.rfile.read(int(length))
        task = self.path.rpartition("/v1/")[2]
        if task not in self.model.tasks:
            self._problem(404, "unknown task", f"this server solves {', '.join(self.model.tasks)}")
            return
        name, job = self.jobs.submit(task, data, self.headers.get("Idempotency-Key", ""))
        can_wait = "respond-async" in self.headers.get("Prefer", "")
        self._finish(name, job, SYNCHRONOUS_S if can_wait else None)

    def do_DELETE(self) -> None:
        """Cancel a job."""
        if self._allowed():
            self.jobs.cancel(self.path.rpartition("/")[2])
            self._json(200, {"status": "cancelled"})

    def _finish(self, name: str, job: Future[bytes], wait_s: float | None) -> None:
        try:
            answer = job.result(wait_s)
        except FutureTimeoutError as error:
            if job.done():  # the model itself ran into a time limit
                self._failed(error)
            else:
                self._json(202, {"job": name, "poll": f"/v1/jobs/{name}"})
        except BaseException as error:
            self._failed(error)
        else:
            self._send(200, answer, "application/zip")

    def _failed(self, error: BaseException) -> None:
        if isinstance(error, (wire.BundleError, RefusedError)):
            self._problem(
                422,
                "the request was refused",
                f"the request {error}" if isinstance(error, wire.BundleError) else str(error),
            )
        else:
            traceback.print_exception(type(error), error, error.__traceback__)
            self._problem(500, "the model failed", _sentence(error))

    def _allowed(self) -> bool:
        given = self.headers.get("Authorization", "")
        if not self.secret or hmac.compare_digest(given.encode(), f"Bearer {self.secret}".encode()):
            return True
        self._problem(401, "unauthorized", "a bearer token is required, and yours is missing or wrong")
        return False

    def _problem(self, status: int, title: str, detail: str) -> None:
        self._json(status, {"title": title, "status": status, "detail": detail}, "application/problem+json")

    def _json(self, status: int, data: Mapping[str, Any], kind: str = "application/json") -> None:
        self._send(status, json.dumps(data).encode(), kind)

    def _send(self, status: int, data: bytes, kind: str) -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(data)))
        self.end_headers()
        self.wfile.write(data)

    def log_message(self, format: str, *arguments: Any) -> None:  # noqa: A002
        """Write one line per request to standard error."""
        print(f"{self.address_string()} {format % arguments}", file=sys.stderr)
