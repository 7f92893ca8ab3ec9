"""Who may connect to a studio: browsers on this machine, or those that know the token.

The server that viser starts has no access control of its own. Without it, any page in the user's browser could connect
to the studio and edit files (cross-site WebSocket hijacking, DNS rebinding).
"""

from __future__ import annotations

import hmac
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from http.cookies import CookieError, SimpleCookie
from threading import Lock
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qs, urlsplit

if TYPE_CHECKING:
    from websockets.http11 import Request, Response

# Names of this machine, under which no other machine can be reached.
LOCAL_HOSTS = ("localhost", "127.0.0.1", "::1")

COOKIE = "simfoundry_studio"

# Characters of a token, which need no escapes in an address or in a cookie, and the least number of them: 16 random
# letters and digits cannot be found by trying.
TOKEN = re.compile(r"[A-Za-z0-9_-]{16,256}\Z")

# The patch below is of the whole process, so that only one server can start at a time.
_starting = Lock()


@dataclass(frozen=True)
class ConnectionGuard:
    """The rules for connections.

    Attributes:
        token: What a browser must know, or empty if everybody on this machine may connect.
    """

    token: str = ""

    def refusal(self, path: str, headers: Any) -> str:
        """Return the reason to refuse a request, or an empty string.

        Args:
            path: The path of the request, with its query.
            headers: The headers of the request, by name.
        """
        host = headers.get("Host", "")
        if not self.token and (urlsplit(f"//{host}").hostname or "") not in LOCAL_HOSTS:
            return "this studio can be reached only as `localhost`"
        origin = headers.get("Origin")
        if origin is not None and urlsplit(origin).netloc != host:
            return "this studio does not accept connections from other pages"
        if self.token and not any(hmac.compare_digest(given, self.token.encode()) for given in _given(path, headers)):
            return "the address of this studio contains a token; open the complete address that the command printed"
        return ""

    def is_in_query(self, path: str) -> bool:
        """Return True if a path contains the token, so that the browser is to keep it."""
        return bool(self.token) and self.token in parse_qs(urlsplit(path).query).get("token", ())


def _given(path: str, headers: Any) -> Iterator[bytes]:
    """Yield the tokens that a request contains."""
    for value in parse_qs(urlsplit(path).query).get("token", ()):
        yield value.encode()
    cookies = SimpleCookie()
    try:
        cookies.load(headers.get("Cookie", ""))
    except CookieError:
        return
    if COOKIE in cookies:
        yield cookies[COOKIE].value.encode()


# Receives the handler of connections and the options of the server that viser starts, which it may change, and returns
# the handler to use.
Extend = Callable[[Any, dict[str, Any]], Any]


@contextmanager
def guarded(guard: ConnectionGuard, extend: Extend = lambda handler, options: handler) -> Iterator[None]:
    """Let the guard decide about all connections to the server that is started in this block.

    Args:
        guard: The rules.
        extend: Function that adds answers to the server. The guard decides before any of them.
    """
    from websockets.asyncio import server

    original = server.serve

    def serve(handler: Any, host: Any, port: Any, **options: Any) -> Any:
        handler = extend(handler, options)
        options["process_request"] = _checked(guard, options["process_request"])
        return original(handler, host, port, **options)

    with _starting:
        server.serve = serve  # type: ignore[misc,assignment]
        try:
            yield
        finally:
            server.serve = original  # type: ignore[misc]


def _checked(
    guard: ConnectionGuard, answer: Callable[[Any, Request], Response | None]
) -> Callable[[Any, Request], Response | None]:
    """Return a function that answers requests, after the guard has accepted them."""

    def process_request(connection: Any, request: Request) -> Response | None:
        reason = guard.refusal(request.path, request.headers)
        if reason:
            refused: Response = connection.respond(403, f"{reason}\n")
            return refused
        response = answer(connection, request)
        if response is not None:
            response.headers["X-Frame-Options"] = "SAMEORIGIN"  # no page of others may cover it and catch clicks
            response.headers["Referrer-Policy"] = "no-referrer"  # the address may contain the token
            if guard.is_in_query(request.path):
                response.headers["Set-Cookie"] = f"{COOKIE}={guard.token}; HttpOnly; SameSite=Strict; Path=/"
        return response

    return process_request
