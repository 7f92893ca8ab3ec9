"""Requests over ZeroMQ, one message in each direction, as used by GR00T's server."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping
from typing import Any

from simfoundry.evaluate.policies.base import InvalidAnswerError, PolicyError
from simfoundry.evaluate.policies.codec import CodecError
from simfoundry.evaluate.policies.groot_codec import pack, unpack
from simfoundry.evaluate.policies.missing import needed
from simfoundry.evaluate.policies.record import PolicyRecord
from simfoundry.evaluate.policies.secret import secret
from simfoundry.evaluate.policies.websocket import last_line
from simfoundry.spec.models.policy import PolicySpec, address_uri

LARGEST = 64 * 2**20
"""Maximum size of an answer [bytes]; ZeroMQ disconnects on a larger one."""
PING_S = 5.0
"""Timeout for the answer to a ping [s]."""


class Requests:
    """A REQ socket, which is replaced after a missing answer, because it cannot be used any more.

    ZeroMQ connects in the background and does not report missing servers: a short ``ping`` before a rollout detects
    them.
    """

    def __init__(self, spec: PolicySpec, record: PolicyRecord) -> None:
        self.spec, self.record = spec, record
        self.uri = address_uri(spec.protocol, spec.address)
        self._socket: Any = None
        self._monitor: Any = None
        self._answered = False

    def begin(self) -> None:
        """Verify that the server is there; raises :class:`PolicyError` after ``spec.retries`` further attempts."""
        fresh = self._socket is None
        for left in range(self.spec.retries, -1, -1):
            if self._ping():
                self.record.connections += fresh
                return
            fresh = True
            if left:
                self.record.reconnects += 1
        tried = f" after {self.spec.retries} attempts to connect again" if self.spec.retries else ""
        raise self.fail(f"no server answers at {self.uri}{tried}")

    def ask(self, endpoint: str, data: Mapping[str, Any] | None = None) -> Any:
        """Return the answer of an endpoint; raises :class:`PolicyError`.

        A query is never repeated, because the server's rollout state would then differ from the actual rollout.
        """
        start = time.monotonic()
        self.record.questions += 1
        try:
            return self._sound(self._exchange(endpoint, data, self._patience()))
        finally:
            self.record.seconds.append(time.monotonic() - start)

    def close(self) -> None:
        """Close the socket; unsent messages are dropped."""
        socket, self._socket = self._socket, None
        if socket is not None:
            socket.disable_monitor()
            self._monitor.close(linger=0)
            socket.close(linger=0)

    def fail(self, message: str, kind: type[PolicyError] = PolicyError) -> PolicyError:
        """Return an error to raise, after adding it to the record."""
        self.record.failed(message)
        return kind(message)

    def _patience(self) -> float:
        return self.spec.timeout if self._answered else self.spec.warm_up

    def _ping(self) -> bool:
        try:
            self._sound(self._exchange("ping", None, min(PING_S, self.spec.timeout)))
        except TimeoutError:
            return False
        return True

    def _sound(self, data: bytes) -> Any:
        if data == b"ERROR":
            raise self.fail(f"the server at {self.uri} failed without giving a reason", InvalidAnswerError)
        try:
            answer = unpack(data)
        except CodecError as error:
            raise self.fail(f"the answer of {self.uri} cannot be read: {error}", InvalidAnswerError) from None
        if isinstance(answer, dict) and "error" in answer:
            reason = last_line(str(answer["error"]))
            raise self.fail(f"the server at {self.uri} failed: {reason}", InvalidAnswerError)
        return answer

    def _exchange(self, endpoint: str, data: Mapping[str, Any] | None, patience: float) -> bytes:
        zmq = needed("zmq", "the protocol of groot")
        needed("msgpack", "the protocol of groot")
        request: dict[str, Any] = {"endpoint": endpoint}
        if data is not None:
            request["data"] = data
        key = secret(self.spec)
        if key is not None:
            request["api_token"] = key
        try:
            packed = pack(request)
        except CodecError as error:
            raise self.fail(f"{self.spec.name} cannot be queried: {error}") from None
        socket = self._opened(zmq)
        try:
            while self._monitor.poll(0):  # lost since the last query, and reconnected by ZeroMQ itself
                lost = _event(self._monitor) == zmq.EVENT_DISCONNECTED
                self.record.reconnects += lost
                self.record.connections += lost
            socket.send(packed)
            self._wait(zmq, socket, patience, endpoint == "ping")
            answer: bytes = socket.recv()
        except zmq.Again:
            self.close()
            if endpoint == "ping":
                raise TimeoutError from None
            raise self.fail(self._silence(patience)) from None
        except zmq.ZMQError as error:
            self.close()
            raise self.fail(f"the connection to {self.uri} was lost ({str(error).lower()})") from None
        self._answered = self._answered or endpoint == "get_action"
        return answer

    def _wait(self, zmq: Any, socket: Any, patience: float, is_ping: bool) -> None:
        """Wait for an answer; raises ``zmq.Again`` on timeout, :class:`PolicyError` if the server has disconnected."""
        poller = zmq.Poller()
        poller.register(socket, zmq.POLLIN)
        poller.register(self._monitor, zmq.POLLIN)
        end = time.monotonic() + patience
        while (left := end - time.monotonic()) > 0:
            ready = dict(poller.poll(left * 1000))
            if socket in ready:
                return
            if self._monitor in ready and _event(self._monitor) == zmq.EVENT_DISCONNECTED and not is_ping:
                self.close()
                large = f"its answer is larger than {LARGEST // 2**20} MiB"
                raise self.fail(f"the server at {self.uri} closed the connection: it has stopped, or {large}")
        raise zmq.Again

    def _silence(self, patience: float) -> str:
        waits = "`timeout`" if self._answered else "`warm_up`"
        return f"{self.uri} did not answer within {patience:g} s; raise {waits} if it needs more"

    def _opened(self, zmq: Any) -> Any:
        if self._socket is None:
            self._answered = False
            socket = zmq.Context.instance().socket(zmq.REQ)
            socket.setsockopt(zmq.LINGER, 0)
            socket.setsockopt(zmq.MAXMSGSIZE, LARGEST)
            socket.setsockopt(zmq.SNDTIMEO, int(self.spec.timeout * 1000))
            self._monitor = socket.get_monitor_socket(zmq.EVENT_DISCONNECTED)
            socket.connect(self.uri)
            self._socket = socket
        return self._socket


def _event(monitor: Any) -> int:
    """Return the number of a monitor event: the first two bytes of a report."""
    return int.from_bytes(monitor.recv_multipart()[0][:2], sys.byteorder)
