"""The clients of openpi and RoboArena: recorded exchanges with the real servers, and everything that can go wrong."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping
from typing import Any

import msgpack
import numpy as np
import pytest
from websockets.sync.server import ServerConnection

from simfoundry.evaluate.policies import websocket
from simfoundry.evaluate.policies.base import InvalidAnswerError, PolicyError
from simfoundry.evaluate.policies.codec import OPENPI_CODEC
from simfoundry.evaluate.policies.openpi import RESET_DONE, OpenpiPolicy, RoboarenaPolicy
from tests.evaluate.drive import (
    GOOD,
    JOINTS,
    assert_driven,
    drive,
    expected,
    observation,
    policy_of,
    spec_of,
)
from tests.evaluate.exchange import handled, read_exchange, replayed, running

CHUNK = np.hstack(
    [JOINTS.astype(np.float32) + 0.01 * np.arange(15)[:, None], np.where(np.arange(15) > 5, 1, 0)[:, None]]
)


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """No server of the tests needs time to start."""
    monkeypatch.setattr(websocket, "FIRST_PAUSE_S", 0.02)
    monkeypatch.setattr(websocket, "LONGEST_PAUSE_S", 0.05)


@pytest.mark.parametrize("protocol", ["openpi", "roboarena"])
def test_the_exchange_with_the_real_server_byte_for_byte(protocol: str) -> None:
    with replayed(read_exchange(protocol)) as (address, wrong):
        outcome = drive(protocol, address)
    assert wrong == []
    assert_driven(outcome)


@pytest.mark.parametrize("protocol", ["openpi", "roboarena"])
def test_another_question_than_the_recorded_is_noticed(protocol: str) -> None:
    """What holds the test above up: one changed byte of what the client said then."""
    frames = read_exchange(protocol)
    first = next(k for k, (who, said) in enumerate(frames[0]) if who == "client" and len(said) > 500)
    said = frames[0][first][1]
    assert isinstance(said, bytes)
    frames[0][first] = ("client", said[:300] + bytes([said[300] ^ 1]) + said[301:])
    with replayed(frames) as (address, wrong):
        drive(protocol, address)
    assert len(wrong) == 1


def test_what_openpi_is_asked() -> None:
    shown = observation(3)
    ((_, _), (who, asked), *_), *_ = read_exchange("openpi")
    assert who == "client" and isinstance(asked, bytes)
    question = OPENPI_CODEC.unpack(asked)
    assert list(question) == [
        "observation/exterior_image_1_left", "observation/wrist_image_left",
        "observation/joint_position", "observation/gripper_position", "prompt",
    ]  # fmt: skip
    assert question["prompt"] == GOOD
    assert question["observation/wrist_image_left"].shape == (24, 24, 3)
    assert not question["observation/wrist_image_left"][:5].any() and question["observation/wrist_image_left"][6].any()
    np.testing.assert_array_equal(question["observation/joint_position"], JOINTS.astype(np.float32))
    np.testing.assert_array_equal(question["observation/gripper_position"], np.array([0.25], np.float32))
    assert shown.images["wrist"].shape == (18, 32, 3)


def test_what_roboarena_is_asked() -> None:
    first, _ = read_exchange("roboarena")
    said = [OPENPI_CODEC.unpack(message) for who, message in first if who == "client" and isinstance(message, bytes)]
    assert [question["endpoint"] for question in said] == ["reset", "infer", "infer", "reset", "infer"]
    assert [question.get("session_id") for question in said] == [None, "rollout-0", "rollout-0", None, "rollout-1"]
    assert said[1]["observation/cartesian_position"].shape == (6,)
    assert said[1]["observation/exterior_image_0_left"].shape == (18, 32, 3)
    assert ("server", RESET_DONE) in first


def answering(*answers: bytes | str, greeting: bytes | str | None = None) -> Any:
    """A handler that says the answers one after another whatever it is asked, over all of its connections."""
    left = list(answers)

    def handle(connection: ServerConnection) -> None:
        connection.send(OPENPI_CODEC.pack({}) if greeting is None else greeting)
        for _ in connection:
            if not left:
                return
            connection.send(left.pop(0))

    return handle


GOOD_ANSWER = OPENPI_CODEC.pack({"actions": CHUNK})


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        ("Traceback (most recent call last):\n  File\nValueError: no model\x07\n", "failed: ValueError: no model?"),
        ("", "failed: no reason was given"),
        (b"\xc1", "it is not valid msgpack"),
        (b"", "it is not valid msgpack"),
        (OPENPI_CODEC.pack([1, 2]), "does not contain `actions`: a `list`"),
        (OPENPI_CODEC.pack({"action": CHUNK}), "does not contain `actions`: action"),
        (OPENPI_CODEC.pack({"actions": CHUNK.tolist()}), "a `list` instead of an array"),
        (OPENPI_CODEC.pack({"actions": CHUNK[:, :7]}), "got (15, 7)"),
        (
            OPENPI_CODEC.pack({"actions": np.where(np.isclose(CHUNK, CHUNK[2, 3]), np.nan, CHUNK)}),
            "number 3 of action 2 (joint 4 of `arm`) is nan",
        ),
        (
            msgpack.packb({"actions": {b"__ndarray__": True, b"data": b"x", b"dtype": "|O", b"shape": [1, 8]}}),
            "it contains an array of `object`",
        ),
    ],
)
def test_an_answer_that_is_none_is_told_recorded_and_left_behind(answer: bytes | str, words: str) -> None:
    with handled(answering(answer, GOOD_ANSWER)) as address:
        policy = OpenpiPolicy(spec_of("openpi", address))
        policy.reset(GOOD, 0)
        with pytest.raises(InvalidAnswerError) as raised:  # a failed rollout, not a missing one
            policy.infer(observation(0))
        assert words in str(raised.value) and policy.record.errors == [str(raised.value)]
        policy.reset(GOOD, 1)
        np.testing.assert_allclose(policy.infer(observation(0)), expected(0), atol=1e-12)
        policy.close()


def test_an_answer_that_is_too_large_is_refused_before_it_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(websocket, "LARGEST", 2**16)
    with handled(answering(bytes(2**17))) as address:
        policy = OpenpiPolicy(spec_of("openpi", address))
        policy.reset(GOOD, 0)
        with pytest.raises(InvalidAnswerError, match="exceeds 0 MiB"):
            policy.infer(observation(0))
        assert (policy.record.reconnects, policy.record.failures) == (0, 1)


@pytest.mark.parametrize(
    ("greeting", "words"),
    [
        ("hello", "failed: hello"),
        (OPENPI_CODEC.pack([1]), "must be a mapping, not a `list`"),
        (b"\xc1", "could not parse the response"),
    ],
)
def test_a_server_that_begins_otherwise(greeting: bytes | str, words: str) -> None:
    with handled(answering(greeting=greeting)) as address:
        policy = OpenpiPolicy(spec_of("openpi", address))
        with pytest.raises(PolicyError, match=words) as raised:
            policy.reset(GOOD, 0)
        assert raised.type is PolicyError  # it was asked for no action yet: no rollout has failed


def test_a_server_that_does_not_answer_in_time() -> None:
    asleep = threading.Event()

    def handle(connection: ServerConnection) -> None:
        connection.send(OPENPI_CODEC.pack({}))
        connection.recv()
        connection.send(GOOD_ANSWER)
        connection.recv()
        asleep.wait(5)

    with handled(handle) as address:
        policy = OpenpiPolicy(spec_of("openpi", address, timeout=0.2, warm_up=4.0))
        policy.reset(GOOD, 0)
        policy.infer(observation(0))
        with pytest.raises(PolicyError, match=r"did not respond within 0.2 s; increase `timeout`"):
            policy.infer(observation(1))
        asleep.set()
        assert policy.record.reconnects == 0  # waiting once is enough


def test_nobody_is_there() -> None:
    policy = OpenpiPolicy(spec_of("openpi", "127.0.0.1:1", retries=2))
    with pytest.raises(PolicyError) as raised:
        policy.reset(GOOD, 0)
    assert str(raised.value) == (
        "could not reach a server at ws://127.0.0.1:1 (connection refused) after 2 attempts to connect again"
    )
    assert (policy.record.reconnects, policy.record.connections, policy.record.failures) == (2, 0, 1)


def test_something_else_is_there() -> None:
    def refuse(connection: ServerConnection, _: Any) -> Any:
        return connection.respond(404, "no\n")

    from websockets.sync.server import serve as plain

    with running(plain(lambda c: None, "127.0.0.1", 0, process_request=refuse)) as address:
        policy = OpenpiPolicy(spec_of("openpi", address))
        with pytest.raises(PolicyError, match=r"is not a policy server \(it responded with status 404\)"):
            policy.reset(GOOD, 0)


class Told:
    """A policy that says where it was told the joints are, and hangs up at the questions it is given."""

    def __init__(self, hang_up: set[int], greeting: Mapping[str, Any] | None = None) -> None:
        self.hang_up, self.greeting = hang_up, greeting or {}
        self.questions: list[dict[str, Any]] = []

    def __call__(self, connection: ServerConnection) -> None:
        connection.send(OPENPI_CODEC.pack(dict(self.greeting)))
        for data in connection:
            assert isinstance(data, bytes)
            question = OPENPI_CODEC.unpack(data)
            self.questions.append(question)
            if len(self.questions) in self.hang_up:
                connection.close()
                return
            if question.get("endpoint") == "reset":
                connection.send(RESET_DONE)
                continue
            steps = np.arange(15)[:, None]
            chunk = np.hstack([question["observation/joint_position"].astype(float) + 0.01 * steps, steps > 5])
            connection.send(OPENPI_CODEC.pack({"actions": chunk}))


def test_a_lost_connection_is_made_anew_and_the_question_put_again() -> None:
    server = Told({2, 3, 5})
    with handled(server) as address:
        policy = OpenpiPolicy(spec_of("openpi", address, retries=3))
        policy.reset(GOOD, 0)
        for step in (0, 8, 16):
            np.testing.assert_allclose(policy.infer(observation(step)), expected(step), atol=1e-12)
        policy.close()
    assert (policy.record.questions, policy.record.connections, policy.record.reconnects) == (3, 4, 3)
    assert policy.record.failures == 0 and len(policy.record.seconds) == 3


def test_attempts_are_counted_by_rollout() -> None:
    server = Told({1, 3, 5, 6, 7})
    with handled(server) as address:
        policy = OpenpiPolicy(spec_of("openpi", address, retries=1))
        for rollout in range(2):
            policy.reset(GOOD, rollout)
            policy.infer(observation(0))
        policy.reset(GOOD, 2)
        with pytest.raises(
            PolicyError, match=r"closed the connection \(1000\) after 1 attempts to connect again"
        ) as raised:
            policy.infer(observation(0))
        assert raised.type is PolicyError  # a missing rollout: nothing is known of the policy
        policy.close()


def test_a_server_that_is_started_again_loses_no_rollout_but_its_own() -> None:
    """RoboArena's server remembers the rollout, so the one in which it ended has failed; those around it stand."""
    greeting = {"image_resolution": [18, 32], "n_external_cameras": 2, "action_space": "joint_position"}
    done: list[str] = []
    server = Told({4}, greeting)
    with handled(server) as address:
        policy = RoboarenaPolicy(spec_of("roboarena", address))
        for rollout in range(3):
            try:
                policy.reset(GOOD, rollout)
                policy.infer(observation(0))
                done.append("done")
            except PolicyError as error:
                done.append(str(error))
        policy.close()
    assert done == ["done", done[1], "done"]
    assert done[1].endswith("closed the connection (1000), so the server's state for this rollout is lost")
    assert policy.record.errors == [done[1]]


SOUND = {
    "image_resolution": [18, 32],
    "needs_wrist_camera": True,
    "n_external_cameras": 2,
    "needs_stereo_camera": False,
    "needs_session_id": True,
    "action_space": "joint_position",
}


@pytest.mark.parametrize(
    ("wish", "words"),
    [
        (
            {"action_space": "joint_velocity"},
            "action space is `joint_velocity`, but the document specifies `action_space: joint_position`",
        ),
        ({"action_space": "cartesian_position"}, "action space is `cartesian_position`"),
        ({"image_resolution": [180, 320]}, "needs images of 320 × 180, but `observation/exterior_image_0_left` has"),
        ({"needs_stereo_camera": True}, "needs the image `observation/exterior_image_0_right`"),
    ],
)
def test_a_server_that_wants_something_else_is_told(wish: dict[str, Any], words: str) -> None:
    with handled(Told(set(), SOUND | wish)) as address:
        policy = policy_of(spec_of("roboarena", address))
        with pytest.raises(PolicyError, match="disagree: ") as raised:
            policy.reset(GOOD, 0)
        assert words in str(raised.value)


@pytest.mark.parametrize(
    "wish", [{}, {"image_resolution": None}, {"n_external_cameras": 1}, {"needs_wrist_camera": False}]
)
def test_a_server_that_wants_no_more_than_there_is(wish: dict[str, Any]) -> None:
    with handled(Told(set(), SOUND | wish)) as address:
        policy = policy_of(spec_of("roboarena", address))
        policy.reset(GOOD, 0)
        np.testing.assert_allclose(policy.infer(observation(0)), expected(0), atol=1e-12)
        policy.close()


def test_a_bare_array_is_an_answer_of_roboarena() -> None:
    with handled(answering(RESET_DONE, OPENPI_CODEC.pack(CHUNK), greeting=OPENPI_CODEC.pack({}))) as address:
        policy = policy_of(spec_of("roboarena", address))
        policy.reset(GOOD, 0)
        np.testing.assert_allclose(policy.infer(observation(0)), expected(0), atol=1e-12)
        policy.close()


def test_a_key_goes_along_in_the_header(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[str | None] = []

    def handle(connection: ServerConnection) -> None:
        assert connection.request is not None
        seen.append(connection.request.headers.get("Authorization"))
        answering(GOOD_ANSWER)(connection)

    monkeypatch.setenv("POLICY_KEY", " s3cret\n")
    with handled(handle) as address:
        for key in ("POLICY_KEY", None):
            policy = OpenpiPolicy(spec_of("openpi", address, api_key=key))
            policy.reset(GOOD, 0)
            policy.infer(observation(0))
            policy.close()
    assert seen == ["Api-Key s3cret", None]


@pytest.mark.parametrize(
    ("value", "words"), [(None, "which is not set"), ("a\nb", "is not a valid key"), ("ключ", "is not a valid key")]
)
def test_a_key_that_is_none(monkeypatch: pytest.MonkeyPatch, value: str | None, words: str) -> None:
    if value is None:
        monkeypatch.delenv("POLICY_KEY", raising=False)
    else:
        monkeypatch.setenv("POLICY_KEY", value)
    policy = OpenpiPolicy(spec_of("openpi", "127.0.0.1:1", api_key="POLICY_KEY"))
    with pytest.raises(PolicyError, match=words) as raised:
        policy.reset(GOOD, 0)
    assert value is None or value not in str(raised.value)


def test_closing_twice_and_without_a_connection() -> None:
    policy = OpenpiPolicy(spec_of("openpi", "127.0.0.1:1"))
    start = time.monotonic()
    policy.close()
    policy.close()
    assert policy.record.questions == 0 and start > 0
