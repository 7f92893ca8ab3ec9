"""A websocket connection to a policy server that uses the protocol of openpi and RoboArena.

The server sends the first message. After that, each exchange consists of one binary request and one binary response.
Messages are not compressed, so a response cannot expand beyond the size that was received. A text message indicates an
error. It contains the server's traceback, and the server closes the connection after sending it (see
``websocket_policy_server.py`` in both projects).
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from simfoundry.evaluate.policies.base import InvalidAnswerError, PolicyError
from simfoundry.evaluate.policies.codec import OPENPI_CODEC
from simfoundry.evaluate.policies.remote import PolicyRecord, ServerConnection, last_line, needed
from simfoundry.spec.models.policy import PolicySpec

if TYPE_CHECKING:
    from websockets.sync.client import ClientConnection

# Maximum size of a response [bytes]; a chunk of actions takes only a few thousand.
LARGEST = 16 * 2**20
# Interval and timeout of keep-alive pings [s]. A server that is compiling its model does not respond to pings for
# minutes, and the default timeout of websockets would close the connection.
PING_S, PONG_S = 60.0, 600.0
# Initial and maximum delay between two connection attempts [s]; the delay doubles after each attempt.
FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.5, 5.0


class LostError(Exception):
    """An error raised if the connection is lost.

    Reconnecting may succeed.
    """


class Connection(ServerConnection):
    """A connection that is opened on demand and reopened at most ``spec.retries`` times per rollout."""

    codec = OPENPI_CODEC

    def __init__(self, spec: PolicySpec, record: PolicyRecord) -> None:
        super().__init__(spec, record)
        self.greeting: Mapping[str, Any] = {}
        self._socket: ClientConnection | None = None
        self._open = ExitStack()
        self._left = spec.retries

    def begin(self) -> None:
        """Start a rollout.

        The number of retries is reset, and the connection is opened if necessary.
        """
        self._left = self.spec.retries
        self._again(self._connect)

    def ask(self, message: Mapping[str, Any], *, again: bool = True, expect_text: str | None = None) -> Any:
        """Return the response to a message.

        Args:
            message: The request.
            again: True to repeat the request after a lost connection. If it is False, the rollout counts as missing
                because the server has lost its rollout state.
            expect_text: The only text message that is not treated as an error.

        Raises:
            PolicyError: If there is no valid response.
        """
        data = self.packed(message)

        def once() -> Any:
            self._connect()
            return self._ask(data, expect_text)

        with self.timed():
            if again:
                return self._again(once)
            try:
                return once()
            except LostError as lost:
                self.close()
                raise self.fail(f"{lost}, so the server's state for this rollout is lost") from None

    def close(self) -> None:
        """Close the connection."""
        self._socket = None
        with suppress(Exception):  # the peer may have disconnected in any way
            self._open.close()

    def _again(self, attempt: Any) -> Any:
        """Call ``attempt`` until it succeeds, up to the number of retries left for the rollout."""
        pause = FIRST_PAUSE_S
        while True:
            try:
                return attempt()
            except LostError as lost:
                self.close()
                self._left -= 1
                if self._left < 0:
                    raise self.fail(f"{lost}{self.retried}") from None
                self.record.reconnects += 1
                time.sleep(pause)
                pause = min(2 * pause, LONGEST_PAUSE_S)

    def _connect(self) -> None:
        if self._socket is not None:
            return
        client = needed("websockets.sync.client", f"the protocol of {self.spec.protocol}")
        from websockets.exceptions import InvalidHandshake, InvalidURI

        key = self.secret()
        is_here = urlsplit(self.uri).hostname in ("localhost", "127.0.0.1", "::1")  # local servers do not need a proxy
        try:
            self._socket = self._open.enter_context(client.connect(
                self.uri, compression=None, max_size=LARGEST, ping_interval=PING_S, ping_timeout=PONG_S,
                close_timeout=1, open_timeout=self.spec.timeout, proxy=None if is_here else True,
                additional_headers={"Authorization": f"Api-Key {key}"} if key else None,
            ))  # fmt: skip
        except InvalidURI:
            raise self.fail(f"`{self.uri}` is not a valid websocket URL") from None
        except InvalidHandshake as error:
            raise self._refused(error) from None
        except (OSError, EOFError) as error:  # includes time-outs
            raise LostError(f"could not reach a server at {self.uri} ({_reason(error)})") from None
        self.record.connections += 1
        self.answered = False
        greeting = self._received(None)
        if not isinstance(greeting, dict):
            self.close()
            first = f"the first message from the server at {self.uri}"
            raise self.fail(f"{first} must be a mapping, not a `{type(greeting).__name__}`")
        self.greeting = greeting

    def _refused(self, error: Exception) -> PolicyError:
        status = getattr(getattr(error, "response", None), "status_code", None)
        if status in (401, 403):
            named = f"the key in {self.spec.api_key}" if self.spec.api_key else "a policy without `api_key`"
            return self.fail(f"the server at {self.uri} rejects {named} ({status})")
        what = f"it responded with status {status}" if status else type(error).__name__
        return self.fail(f"the server at {self.uri} is not a policy server ({what})")

    def _ask(self, data: bytes, expect_text: str | None) -> Any:
        with self._connected() as socket:
            socket.send(data)
        answer = self._received(expect_text)
        self.answered = True
        return answer

    @contextmanager
    def _connected(self) -> Iterator[ClientConnection]:
        """Provide the socket, and convert the exceptions that it raises if the connection is lost."""
        from websockets.exceptions import ConnectionClosed

        assert self._socket is not None
        try:
            yield self._socket
        except ConnectionClosed as closed:
            raise self._closed(closed) from None
        except TimeoutError:
            self.close()
            raise self.silent(self.patience) from None
        except OSError as error:
            raise LostError(f"the connection to {self.uri} was lost ({_reason(error)})") from None

    def _received(self, expect_text: str | None) -> Any:
        """Receive one message.

        The connection is closed after an invalid message because later responses would no longer match their requests.
        """
        with self._connected() as socket:
            data = socket.recv(timeout=self.patience)
        if isinstance(data, str):
            if expect_text is not None and data == expect_text:
                return data
            self.close()
            raise self.fail(f"the server at {self.uri} failed: {last_line(data)}", InvalidAnswerError)
        try:
            return self.unpacked(data)
        except InvalidAnswerError:
            self.close()
            raise

    def _closed(self, closed: Any) -> Exception:
        if closed.sent is not None and closed.sent.code == 1009:  # closed by us: the message exceeded the size limit
            self.close()
            return self.fail(f"the response from {self.uri} exceeds {LARGEST // 2**20} MiB", InvalidAnswerError)
        code = closed.rcvd.code if closed.rcvd is not None else None
        return LostError(f"the server at {self.uri} closed the connection" + (f" ({code})" if code else ""))


def _reason(error: BaseException) -> str:
    return (getattr(error, "strerror", None) or str(error) or type(error).__name__).lower()
