"""What the tests and the proof ask of a policy server, real or replayed, and what a policy is shown."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import count
from typing import Any

import numpy as np

from simfoundry.evaluate.policies.base import Image, Observation, PolicyError, RobotReading
from simfoundry.evaluate.policies.openpi import OpenpiPolicy, RoboarenaPolicy
from simfoundry.evaluate.policies.remote import RemotePolicy
from simfoundry.geometry.frames import Array, Pose
from simfoundry.scene.state import SceneState
from simfoundry.spec.models.policy import PolicySpec

HORIZON, CHUNK = 8, 15
JOINTS = np.array([0.1, -0.5, 0.2, -2.1, 0.3, 1.6, 0.7])
CAMERAS = {
    "openpi": {"observation/exterior_image_1_left": "left", "observation/wrist_image_left": "wrist"},
    "roboarena": {
        "observation/exterior_image_0_left": "left",
        "observation/exterior_image_1_left": "right",
        "observation/wrist_image_left": "wrist",
    },
    "groot": {"exterior_image_1_left": "left", "wrist_image_left": "wrist"},
}
SIZES = {"openpi": (24, 24), "roboarena": (32, 18), "groot": (32, 18)}
GOOD, BAD = "put the cup in the bowl", "fail"


def spec_of(protocol: str, address: str, **more: Any) -> PolicySpec:
    """A policy with small pictures, that waits for nothing long."""
    size = SIZES[protocol]
    views = {key: {"camera": name, "size": size, "render": (32, 18)} for key, name in CAMERAS[protocol].items()}
    fields = {"action_space": "joint_position", "horizon": HORIZON, "timeout": 5.0, "warm_up": 10.0, "cameras": views}
    head = {"simfoundry": "policy/1", "name": "tested", "protocol": protocol, "address": address}
    return PolicySpec.model_validate({**head, **fields, **more})


def observation(step: int = 0, robots: int = 1, instruction: str = GOOD) -> Observation:
    """What a policy is shown after some steps: noise in every picture, joints that differ from step to step."""
    rng = np.random.default_rng(step)
    images: dict[str, Image] = {
        n: rng.integers(0, 256, (18, 32, 3), dtype=np.uint8) for n in ("left", "right", "wrist")
    }
    hand = Pose.of([0.4, 0.1, 0.3], [0.1, 0.9, -0.3, 0.2])
    one = RobotReading(JOINTS + 0.01 * step, 0.25, Pose.of([0.4, 0.1, 1.3], [0.1, 0.9, -0.3, 0.2]), hand)
    names = ("arm", "left", "right")[:robots]
    return Observation(step / 15, instruction, dict.fromkeys(names, one), images, SceneState.of({}, {}))


def expected(step: int) -> Array:
    """What the servers of the tests answer: the joints that they were told, moving on; the gripper closes half-way."""
    steps = np.arange(CHUNK)[:, None]
    told = (JOINTS + 0.01 * step).astype(np.float32).astype(np.float64)
    return np.hstack([told + 0.01 * steps, (steps > 5).astype(float)])[:HORIZON]


def policy_of(spec: PolicySpec) -> RemotePolicy:
    """A client whose names of rollouts are always the same."""
    if spec.protocol == "openpi":
        return OpenpiPolicy(spec)
    numbers = count()
    return RoboarenaPolicy(spec, new_session=lambda: f"rollout-{next(numbers)}")


@dataclass(frozen=True, eq=False)
class Outcome:
    """What came of :func:`drive`."""

    chunks: tuple[Array, ...]
    error: str
    record: dict[str, Any]


def drive(protocol: str, address: str) -> Outcome:
    """Two rollouts and between them one that the server fails: chunks, the error in words, and what was recorded."""
    policy = policy_of(spec_of(protocol, address))
    chunks, error = [], ""
    try:
        policy.reset(GOOD, 0)
        chunks += [policy.infer(observation(0)), policy.infer(observation(HORIZON))]
        policy.reset(BAD, 1)
        try:
            policy.infer(observation(3))
        except PolicyError as raised:
            error = str(raised)
        policy.reset(GOOD, 2)
        chunks.append(policy.infer(observation(5)))
    finally:
        policy.close()
    return Outcome(tuple(chunks), error, dict(policy.record.to_json()))


def assert_driven(outcome: Outcome) -> None:
    """Chunks carried out as the server gave them, the failure told, and what came after it unharmed."""
    for chunk, step in zip(outcome.chunks, (0, HORIZON, 5), strict=True):
        np.testing.assert_allclose(chunk, expected(step), atol=1e-12)
    assert outcome.error.endswith("failed: ValueError: nothing is known of `fail`"), outcome.error
    assert outcome.record["errors"] == [outcome.error]
    assert (outcome.record["connections"], outcome.record["failures"]) == (2, 1)
