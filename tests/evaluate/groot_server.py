"""A stand-in for GR00T's server, written from its protocol: REP, msgpack, arrays as NumPy files."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from threading import Thread
from typing import Any

import msgpack
import numpy as np
import zmq

from tests.evaluate.drive import CHUNK

LANGUAGE = "annotation.language.language_instruction"


def config(keys: list[str], steps: list[int]) -> dict[str, Any]:
    """A modality as the server describes it."""
    described = {"delta_indices": steps, "modality_keys": keys, "action_configs": None}
    return {"__ModalityConfig_class__": True, "as_json": described}


def modalities(**changed: Any) -> dict[str, Any]:
    """What a server of DROID takes and gives."""
    state = ["eef_9d", "gripper_position", "joint_position"]
    sound = {
        "video": config(["exterior_image_1_left", "wrist_image_left"], [0]),
        "state": config(state, [0]),
        "action": config(state, list(range(CHUNK))),
        "language": config([LANGUAGE], [0]),
    }
    return sound | changed


@dataclass
class GrootServer:
    """Answers by the protocol and keeps the questions; ``answers`` of an endpoint, raw bytes, go before."""

    modalities: dict[str, Any] = field(default_factory=modalities)
    answers: dict[str, bytes | None] = field(default_factory=dict)
    token: str | None = None
    questions: list[dict[str, Any]] = field(default_factory=list)
    silent_pings: int = 0

    def answer(self, message: bytes) -> bytes | None:
        """The answer to a question; None where there is none."""
        question = msgpack.unpackb(message, object_hook=_decoded)
        self.questions.append(question)
        endpoint = question["endpoint"]
        if self.token is not None and question.get("api_token") != self.token:
            return _packed({"error": "Unauthorized: Invalid API token"})
        if endpoint in self.answers:
            return self.answers[endpoint]
        if endpoint == "ping":
            self.silent_pings -= 1
            return None if self.silent_pings >= 0 else _packed({"status": "ok", "message": "Server is running"})
        if endpoint == "get_modality_config":
            return _packed(self.modalities)
        if endpoint == "reset":
            return _packed({})
        if endpoint == "get_action":
            return self._action(question["data"]["observation"])
        return _packed({"error": f"Unknown endpoint: {endpoint}"})

    def _action(self, seen: dict[str, Any]) -> bytes:
        if seen["language"][LANGUAGE] == [["fail"]]:
            return _packed({"error": "nothing is known of `fail`"})
        steps = np.arange(CHUNK)[None, :, None]
        joints = (seen["state"]["joint_position"][:, -1:] + 0.01 * steps).astype(np.float32)
        gripper = np.where(steps > 5, 0.9, 0.1).astype(np.float32)
        return _packed([{"joint_position": joints, "gripper_position": gripper, "eef_9d": np.zeros((1, CHUNK, 9))}, {}])


@contextmanager
def serving(server: GrootServer, port: int | None = None) -> Iterator[str]:
    """The address of a server while the block runs; then it hangs up, as one that is killed."""
    context = zmq.Context()
    sockets: zmq.Socket[bytes] = context.socket(zmq.ROUTER)  # a REP must answer before it may be asked again
    sockets.setsockopt(zmq.LINGER, 0)
    bound = sockets.bind_to_random_port("tcp://127.0.0.1") if port is None else port
    if port is not None:
        sockets.bind(f"tcp://127.0.0.1:{port}")
    stop = context.socket(zmq.PAIR)
    stop.bind("inproc://stop")
    other = context.socket(zmq.PAIR)
    other.connect("inproc://stop")

    def run() -> None:
        poller = zmq.Poller()
        poller.register(sockets, zmq.POLLIN)
        poller.register(stop, zmq.POLLIN)
        while stop not in dict(poller.poll()):
            *envelope, message = sockets.recv_multipart()
            answer = server.answer(message)
            if answer == b"DIE":
                break
            if answer is not None:
                sockets.send_multipart([*envelope, answer])
        sockets.close(0)

    thread = Thread(target=run, daemon=True)
    thread.start()
    try:
        yield f"127.0.0.1:{bound}"
    finally:
        other.send(b"")
        thread.join(5)
        context.destroy(0)


def _packed(answer: Any) -> bytes:
    packed: bytes = msgpack.packb(answer, default=_encoded)
    return packed


def _encoded(value: Any) -> Any:
    stream = io.BytesIO()
    np.save(stream, value, allow_pickle=False)
    return {"__ndarray_class__": True, "as_npy": stream.getvalue()}


def _decoded(found: dict[str, Any]) -> Any:
    return np.load(io.BytesIO(found["as_npy"]), allow_pickle=False) if "__ndarray_class__" in found else found
