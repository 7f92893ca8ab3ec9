"""Reach a model over HTTP, with limits on time and size. Every failure becomes one sentence.

``GET /v1`` describes the server, and ``POST /v1/{task}`` takes a bundle. The answer is a bundle (200), or the name of a
job (202) whose result is fetched from ``GET /v1/jobs/{job}``. Errors are described as problem+json (RFC 9457).
"""

from __future__ import annotations

import json
import re
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, NamedTuple

from simfoundry.models.contract import ModelError, plain
from simfoundry.models.wire import MAX_BUNDLE_BYTES, MAX_JSON_BYTES, BundleError, read_json

TIMEOUT_S = 300.0  # Response timeout [s]; mesh generators take a minute or two

CONNECT_S = 10.0  # Time limit for a connection [s], after which a server counts as absent

DESCRIBE_S = 10.0  # Time limit for a server's description [s], which needs no model

MAX_QUOTE_BYTES = 10_000  # Bytes of an error that are looked at; of these, the first sentences are quoted

# Requests are repeated after these pauses [s]. Since they carry an `Idempotency-Key`, this is safe.
PAUSES_S = (0.5, 2.0)

# Status codes after which a repeated request may succeed: too many requests, bad gateway, unavailable, gateway timeout.
TRANSIENT = (429, 502, 503, 504)

POLL_S = (0.2, 3.0)  # First and longest interval between questions about a job [s]

JOB = re.compile("[A-Za-z0-9_-]{1,64}")


class Response(NamedTuple):
    """A response, whose body is complete."""

    status: int
    reason: str
    body: bytes


def request_bytes(
    method: str,
    url: str,
    server: str,
    timeout_s: float = TIMEOUT_S,
    max_bytes: int = MAX_BUNDLE_BYTES,
    **content: Any,
) -> Response:
    """Send a request and return the response with any status.

    Args:
        method: HTTP method.
        url: URL of the server, which must use HTTP or HTTPS. Redirections are not followed, because they would carry
            the content to another server.
        server: Name of the server for error messages, such as `the image model`.
        timeout_s: Time limit for the whole response [s], however slowly it arrives.
        max_bytes: Maximum size of the response [bytes].
        **content: Content of the request, as accepted by ``httpx.stream``: ``content``, ``json``, ``data``, ``files``,
            ``headers``.

    Raises:
        ModelError: If the URL is invalid, if the server does not respond in time, or if the response is too large.
    """
    import httpx

    if not url.startswith(("http://", "https://")):
        raise ModelError(f"the URL of {server} must start with http:// or https://, not `{url}`")
    deadline = time.monotonic() + timeout_s
    limits = httpx.Timeout(timeout_s, connect=min(CONNECT_S, timeout_s))
    # Bundles and images are compressed already, and a compressed response could grow beyond any limit when it is read.
    content["headers"] = {**content.get("headers", {}), "Accept-Encoding": "identity"}
    try:
        with httpx.stream(method, url, timeout=limits, follow_redirects=False, **content) as answer:
            if int(answer.headers.get("content-length", 0) or 0) > max_bytes:
                raise _too_large(server, url, max_bytes)
            data = bytearray()
            for chunk in answer.iter_raw():
                data += chunk
                if len(data) > max_bytes:
                    raise _too_large(server, url, max_bytes)
                if time.monotonic() > deadline:
                    raise ModelError(f"{server} at {url} did not finish its response within {timeout_s:.3g} s")
    except httpx.TimeoutException as error:
        if isinstance(error, httpx.ConnectTimeout):
            raise _absent(server, url, "the connection timed out") from None
        raise ModelError(f"{server} at {url} did not respond within {timeout_s:.3g} s") from None
    except (httpx.HTTPError, httpx.InvalidURL, ValueError) as error:
        raise _absent(server, url, plain(error) or type(error).__name__) from None
    return Response(answer.status_code, answer.reason_phrase, bytes(data))


def _too_large(server: str, url: str, max_bytes: int) -> ModelError:
    return ModelError(f"{server} at {url} returned more than {max_bytes // 2**20} MiB")


class AbsentServerError(ModelError):
    """Raised if a connection fails, so that the request may be repeated."""


def _absent(server: str, url: str, reason: str) -> AbsentServerError:
    return AbsentServerError(f"{server} at {url} did not respond ({reason}); is it running, and is the URL correct?")


def refused(response: Response, server: str, url: str) -> ModelError:
    """Return an error that quotes the server's own words."""
    text = response.body[:MAX_QUOTE_BYTES].decode(errors="replace")
    with suppress(ValueError, AttributeError, RecursionError):  # plain text is quoted as it is
        problem = json.loads(response.body[:MAX_JSON_BYTES])
        text = str(problem.get("detail") or problem.get("title") or text)
    where = f"{server} at {url} returned {response.status} {plain(response.reason)}"
    if 300 <= response.status < 400:
        return ModelError(f"{where}, but redirections are not followed; configure the final URL")
    return ModelError(f"{where}: {plain(text) or 'no explanation'}")


@dataclass(frozen=True)
class HttpTransport:
    """A server that speaks ``bundle/1`` over HTTP.

    Attributes:
        url: URL of the server, without ``/v1``.
        token: Bearer token, or an empty string. It is sent to this URL only, and appears in no message.
        timeout_s: Time limit for one answer [s].
    """

    url: str
    token: str = ""
    timeout_s: float = TIMEOUT_S

    @property
    def place(self) -> str:
        """The URL, without a user name and password."""
        return re.sub("//[^/@]*@", "//", self.url.rstrip("/"))

    def exchange(self, task: str, digest: str, data: bytes) -> bytes:
        """Send a request, repeating it if the server is briefly unavailable, and return the answer's bytes."""
        deadline = time.monotonic() + self.timeout_s
        headers = {"Content-Type": "application/zip", "Idempotency-Key": digest, "Prefer": "respond-async"}
        path = f"/v1/{task}"
        for pause in (*PAUSES_S, float("inf")):
            is_last = time.monotonic() + pause > deadline
            try:
                response = self._send("POST", path, deadline, content=data, headers=headers)
            except AbsentServerError:
                if is_last:
                    raise
            else:
                if is_last or response.status not in TRANSIENT:
                    break
            time.sleep(pause)
        if response.status == 202:
            return self._wait(response, path, deadline)
        if response.status != 200:
            raise refused(response, f"the model for `{task}`", self.place)
        return response.body

    def describe(self) -> Mapping[str, Any]:
        """Return the server's description, ``GET /v1``."""
        response = self._send("GET", "/v1", time.monotonic() + min(DESCRIBE_S, self.timeout_s))
        if response.status != 200:
            raise refused(response, "the model server", self.place)
        try:
            return read_json(response.body[: MAX_JSON_BYTES + 1], "description")
        except BundleError as error:
            raise ModelError(f"the model server at {self.place} {error}") from None

    def _send(self, method: str, path: str, deadline: float, **content: Any) -> Response:
        headers = content.pop("headers", {}) | ({"Authorization": f"Bearer {self.token}"} if self.token else {})
        left = max(0.1, deadline - time.monotonic())
        return request_bytes(
            method, f"{self.url.rstrip('/')}{path}", "the model server", left, headers=headers, **content
        )

    def _wait(self, response: Response, path: str, deadline: float) -> bytes:
        """Ask for the result of a job until it is there, and cancel the job if time is up."""
        try:
            job = str(read_json(response.body, "description of a job").get("job"))
        except BundleError as error:
            raise ModelError(f"the model server at {self.place} {error}") from None
        if not JOB.fullmatch(job):
            raise ModelError(f"the model server at {self.place} named a job {job[:40]!r}, which is not a plain name")
        pause = POLL_S[0]
        while time.monotonic() + pause < deadline:
            time.sleep(pause)
            pause = min(1.5 * pause, POLL_S[1])
            response = self._send("GET", f"/v1/jobs/{job}", max(deadline, time.monotonic() + CONNECT_S))
            if response.status == 200:
                return response.body
            if response.status != 202 and response.status not in TRANSIENT:
                raise refused(response, f"the model behind {path}", self.place)
        self._send("DELETE", f"/v1/jobs/{job}", time.monotonic() + CONNECT_S)
        raise ModelError(f"the model server at {self.place} did not finish its job within {self.timeout_s:g} s")
