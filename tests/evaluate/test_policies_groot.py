"""The client of GR00T against a stand-in written from its protocol."""

from __future__ import annotations

from typing import Any

import msgpack
import numpy as np
import pytest

from simfoundry.evaluate.policies import groot
from simfoundry.evaluate.policies.base import InvalidAnswerError, PolicyError
from simfoundry.evaluate.policies.groot import GrootPolicy, eef_9d
from simfoundry.evaluate.policies.remote import resize_with_pad
from simfoundry.geometry.frames import Pose
from tests.evaluate.drive import GOOD, HORIZON, expected, observation, spec_of
from tests.evaluate.groot_server import LANGUAGE, GrootServer, config, modalities, serving


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """No server of the tests needs long to say that it is there."""
    monkeypatch.setattr(groot, "PING_S", 0.4)


def policy(address: str, **more: Any) -> GrootPolicy:
    return GrootPolicy(spec_of("groot", address, **more))


def test_chunks_are_carried_out() -> None:
    server = GrootServer()
    with serving(server) as address:
        asked = policy(address)
        asked.reset(GOOD, 0)
        for step in (0, HORIZON):
            np.testing.assert_allclose(asked.infer(observation(step)), expected(step), atol=1e-6)
        asked.close()
    assert [q["endpoint"] for q in server.questions] == ["ping", "get_modality_config", "reset", *["get_action"] * 2]
    assert "data" not in server.questions[1] and server.questions[2]["data"] == {"options": None}
    assert (asked.record.questions, asked.record.connections, asked.record.failures) == (4, 1, 0)


def test_what_the_server_is_shown() -> None:
    server = GrootServer()
    with serving(server) as address:
        asked = policy(address)
        asked.reset(GOOD, 0)
        shown = observation(3)
        asked.infer(shown)
        asked.close()
    seen = server.questions[-1]["data"]["observation"]
    assert {k: (v.dtype.str, v.shape) for k, v in seen["video"].items()} == {
        "exterior_image_1_left": ("|u1", (1, 1, 18, 32, 3)),
        "wrist_image_left": ("|u1", (1, 1, 18, 32, 3)),
    }
    np.testing.assert_array_equal(seen["video"]["exterior_image_1_left"][0, 0], shown.images["left"])
    assert {k: (v.dtype.str, v.shape) for k, v in seen["state"].items()} == {
        "eef_9d": ("<f4", (1, 1, 9)),
        "gripper_position": ("<f4", (1, 1, 1)),
        "joint_position": ("<f4", (1, 1, 7)),
    }
    assert seen["language"] == {LANGUAGE: [[GOOD]]}
    assert resize_with_pad(shown.images["left"], asked.cameras["left"]) is shown.images["left"]


def test_the_hand_is_counted_as_in_droid() -> None:
    """Its z axis comes out as minus the first column: the fixed turn sends (a, b, c) to (-b, c, -a)."""
    pose = Pose.of([0.4, 0.1, 0.3], [0.3, -0.5, 0.7, 0.2])
    r = pose.rotation
    expected = [*pose.p, -r[0, 1], r[0, 2], -r[0, 0], -r[1, 1], r[1, 2], -r[1, 0]]
    np.testing.assert_allclose(eef_9d(pose), expected, atol=1e-12)


def test_pictures_of_earlier_steps_are_those_of_earlier_questions() -> None:
    views = config(["wrist_image_left"], [-2 * HORIZON, -HORIZON, 0])
    server = GrootServer(modalities(video=views))
    with serving(server) as address:
        asked = policy(address)
        for rollout in range(2):
            asked.reset(GOOD, rollout)
            for k in range(4):
                asked.infer(observation(HORIZON * k))
        asked.close()
    actions = [
        q["data"]["observation"]["video"]["wrist_image_left"]
        for q in server.questions
        if "observation" in q.get("data", {})
    ]
    for rollout in range(2):
        for k in range(4):
            for moment, back in enumerate((2, 1, 0)):
                image = observation(HORIZON * max(0, k - back)).images["wrist"]
                np.testing.assert_array_equal(actions[4 * rollout + k][0, moment], image)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"video": config(["front_view"], [0])}, "the image `front_view`, which is missing from `cameras` in tested"),
        ({"state": config(["left_hand"], [0])}, "needs the state `left_hand`; this client supports joint_position"),
        ({"action": config(["eef_9d"], [0])}, "actions do not contain `joint_position`, only eef_9d"),
        ({"video": config(["wrist_image_left"], [-15, 0])}, "15 steps back, but with `horizon: 8` there is no request"),
        ({"language": {}}, "`modality_keys` in the server's `language` is not a list of names"),
        ({"state": config(["joint_position"], [])}, "`delta_indices` in the server's `state` is not a list of steps"),
        ({"action": None}, "does not describe its `action`"),
    ],
)  # fmt: skip
def test_a_server_that_takes_something_else_is_told(changed: dict[str, Any], words: str) -> None:
    with serving(GrootServer(modalities(**changed))) as address:
        asked = policy(address)
        with pytest.raises(PolicyError) as raised:
            asked.reset(GOOD, 0)
        asked.close()
    assert words in str(raised.value) and asked.record.errors == [str(raised.value)]


def action(**parts: Any) -> bytes:
    from simfoundry.evaluate.policies.codec import GROOT_CODEC

    sound = {"joint_position": np.zeros((1, 15, 7), np.float32), "gripper_position": np.zeros((1, 15, 1), np.float32)}
    return GROOT_CODEC.pack([{k: v for k, v in (sound | parts).items() if v is not None}, {}])


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        (msgpack.packb({"error": "CUDA out of memory"}), "failed: CUDA out of memory"),
        (b"ERROR", "failed without stating a reason"),
        (b"\xc1", "it is not valid msgpack"),
        (msgpack.packb([]), "a `list`, not a mapping"),
        (msgpack.packb(7), "a `int`, not a mapping"),
        (action(joint_position=None), "`joint_position` is a `NoneType`"),
        (action(joint_position=np.zeros((15, 7))), "`joint_position` is an array of shape (15, 7)"),
        (action(joint_position=np.zeros((2, 15, 7))), "`joint_position` is an array of shape (2, 15, 7)"),
        (action(gripper_position=np.zeros((1, 14, 1))), "15 steps for the joints but 14 for the gripper"),
        (action(gripper_position=np.zeros((1, 15, 1), bool)), "an array of `bool`"),
        (action(joint_position=np.full((1, 15, 7), np.nan)), "number 0 of action 0 (joint 1 of `arm`) is nan"),
        (action(joint_position=np.zeros((1, 15, 6))), "for 7 joints and the gripper of `arm`; got (15, 7)"),
    ],
)
def test_an_answer_that_is_none_is_told_and_recorded(answer: bytes, words: str) -> None:
    server = GrootServer(answers={"get_action": answer})
    with serving(server) as address:
        asked = policy(address)
        asked.reset(GOOD, 0)
        with pytest.raises(InvalidAnswerError) as raised:
            asked.infer(observation(0))
        assert words in str(raised.value) and asked.record.errors == [str(raised.value)]
        server.answers.clear()
        asked.reset(GOOD, 1)  # nothing of it is left
        np.testing.assert_allclose(asked.infer(observation(2)), expected(2), atol=1e-6)
        asked.close()


def test_an_answer_that_is_too_large_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(groot, "LARGEST", 2**20)
    with serving(GrootServer(answers={"get_action": bytes(2**21)})) as address:
        asked = policy(address)
        asked.reset(GOOD, 0)
        with pytest.raises(
            PolicyError, match="closed the connection: either it has stopped, or its response is larger than 1 MiB"
        ):
            asked.infer(observation(0))
        asked.close()


def test_a_server_that_does_not_answer() -> None:
    server = GrootServer(answers={"get_action": None})
    with serving(server) as address:
        asked = policy(address, warm_up=0.3)
        asked.reset(GOOD, 0)
        with pytest.raises(PolicyError, match=r"did not respond within 0.3 s; increase `warm_up`"):
            asked.infer(observation(0))
        server.answers.clear()
        asked.reset(GOOD, 1)
        np.testing.assert_allclose(asked.infer(observation(2)), expected(2), atol=1e-6)
        asked.close()


def test_a_server_that_dies_during_a_question_and_comes_back() -> None:
    with serving(GrootServer(answers={"get_action": b"DIE"})) as address:
        asked = policy(address)
        asked.reset(GOOD, 0)
        with pytest.raises(PolicyError, match="closed the connection"):
            asked.infer(observation(0))
    with serving(GrootServer(), int(address.rpartition(":")[2])):
        asked.reset(GOOD, 1)
        np.testing.assert_allclose(asked.infer(observation(2)), expected(2), atol=1e-6)
        asked.close()
    assert (asked.record.connections, asked.record.failures) == (2, 1)


def test_pings_are_repeated_as_often_as_the_document_says() -> None:
    with serving(GrootServer(silent_pings=2)) as address:
        asked = policy(address, retries=2)
        asked.reset(GOOD, 0)
        asked.close()
        assert (asked.record.reconnects, asked.record.connections) == (2, 1)
    with serving(GrootServer(silent_pings=9)) as address:
        asked = policy(address, retries=1)
        with pytest.raises(PolicyError, match=r"could not reach a server at tcp://127.0.0.1:[0-9]+ after 1 attempts"):
            asked.reset(GOOD, 0)
        asked.close()


def test_a_key_goes_along_and_is_never_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GROOT_TOKEN", "s3cret")
    with serving(GrootServer(token="s3cret")) as address:
        asked = policy(address, api_key="GROOT_TOKEN")
        asked.reset(GOOD, 0)
        asked.close()
        asked = policy(address)
        with pytest.raises(PolicyError, match="Unauthorized"):
            asked.reset(GOOD, 0)
        asked.close()


def test_one_arm_only() -> None:
    with serving(GrootServer()) as address:
        asked = policy(address)
        asked.reset(GOOD, 0)
        with pytest.raises(PolicyError, match="controls one arm, but the task has 2 robots"):
            asked.infer(observation(0, robots=2))
        asked.close()
