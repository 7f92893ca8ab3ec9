"""A single attempt: a rollout of the policy, and its replay in another process."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from simfoundry.assets.cache import Cache
from simfoundry.data.shards import Attempt
from simfoundry.errors import SimfoundryError
from simfoundry.evaluate.entries import Contender, OpenPolicies
from simfoundry.evaluate.observations import pose_numbers
from simfoundry.evaluate.policies.base import Policy, RobotReading
from simfoundry.evaluate.policies.open_loop import ReplayPolicy
from simfoundry.evaluate.resets.starts import RolloutStart, StartSearch, state_from_json, state_to_json
from simfoundry.evaluate.rollouts.rollout import Rollout, RolloutEnd, rollout
from simfoundry.evaluate.run import SILENCE_S
from simfoundry.evaluate.task import Task, load_task
from simfoundry.geometry.frames import Array
from simfoundry.predicates import Judge
from simfoundry.runtime.executors import JobLimits
from simfoundry.runtime.workers import GRACE_S, Worker, WorkerError, at_worker_exit
from simfoundry.scene.state import SceneState
from simfoundry.spec.models.signals import ActionSpace
from simfoundry.worlds import open_world
from simfoundry.worlds.base import World

# The simulator in which demonstrations are recorded; replay is bit-identical only there.
ENGINE = "mujoco"

# Each worker has a second process that replays, and the two take turns.
LIMITS = JobLimits(SILENCE_S, processes=2)

NOT_REPRODUCED = "not reproduced"
"""The end of an attempt whose replay differed from the rollout."""


@dataclass(frozen=True)
class AttemptJob:
    """An attempt to carry out.

    Attributes:
        index: The index of the attempt in the recording.
        document: The task document.
        name: The task document as the recording names it, or an empty string if the recording has only one task.
        contender: The policy.
        seed: The seed for the initial states.
        start: The index of the initial state of the task.
    """

    index: int
    document: Path
    name: str
    contender: Contender
    seed: int
    start: int


def carry_out(job: AttemptJob) -> Attempt | SimfoundryError:
    """Run a rollout, and if it succeeds, replay it in another process.

    Errors are returned, because workers report exceptions without their type.
    """
    at_worker_exit(close)
    try:
        opened = open_task(job.document)
        start, policy = opened.start(job.seed, job.start), opened.policy(job.contender)
        done = rollout(opened.task, start, policy, opened.world, opened.judge)
        return verified_attempt(job, start, done, policy.action_space, _origin(policy))
    except SimfoundryError as error:
        return error


def verified_attempt(
    job: AttemptJob, start: RolloutStart, done: Rollout, space: ActionSpace, more: Mapping[str, Any]
) -> Attempt:
    """Return the attempt that a rollout made. If the rollout succeeded, it is replayed in another process first.

    Args:
        job: The attempt.
        start: The initial state of the rollout.
        done: The rollout.
        space: The meaning of its actions.
        more: Further facts about the attempt.

    Raises:
        SimfoundryError: If the rollout cannot be replayed.
    """
    about = {**attempt_facts(job, start, done), **more}
    if not done.success:
        return Attempt(about)
    initial = state_to_json(start.state)
    recorded = _Recorded(start.seed, start.index, initial, done.actions, str(space), done.action_hz)
    try:
        reply = _verifier().call(f"{__name__}:replay", job.document, recorded)
    except WorkerError as error:
        raise SimfoundryError(f"the process that replays attempt {job.index} {error.how}") from None
    if isinstance(reply, SimfoundryError):
        raise reply
    digest, steps, arrays = reply
    if (digest, steps) != (done.digest, done.steps):
        reason = f"the replay reached {digest} after {steps} steps, but the rollout {done.digest} after {done.steps}"
        return Attempt({**about, "success": False, "kept": False, "end": NOT_REPRODUCED, "reason": reason})
    facts = {"action_space": recorded.action_space, "action_hz": recorded.action_hz}
    return Attempt({**about, "kept": True, **facts, "initial": initial}, {"actions": done.actions, **arrays})


def attempt_facts(job: AttemptJob, start: RolloutStart, done: Rollout) -> dict[str, Any]:
    """Return the entry in ``shard.json`` of an attempt that was not kept."""
    return {
        "index": job.index,
        **({"document": job.name} if job.name else {}),
        "seed": job.seed,
        "cells": {name: list(cell) for name, cell in start.cells.items()},
        "start": start.digest,
        "success": done.success,
        "kept": False,
        "end": str(done.end),
        "reason": done.reason,
        "steps": done.steps,
        "subtasks": dict(done.subtasks),
        "trajectory": done.digest,
    }


def _origin(policy: Policy) -> dict[str, Any]:
    """Return where the actions of the last rollout came from, if the policy states it."""
    return {"origin": json.loads(json.dumps(dict(policy.origin)))} if policy.origin else {}


@dataclass(frozen=True, eq=False)
class _Recorded:
    """The initial state of a rollout as plain data, with its seed and index, and the actions that were executed."""

    seed: int
    index: int
    initial: Mapping[str, Any]
    actions: Array
    action_space: str
    action_hz: float


def replay(document: Path, recorded: _Recorded) -> tuple[str, int, dict[str, Array]] | SimfoundryError:
    """Execute recorded actions.

    Returns:
        The digest of the trajectory, the number of control steps, and the states as arrays.
    """
    at_worker_exit(close)
    try:
        opened = open_task(document)
        space = ActionSpace.parse(recorded.action_space)
        policy = ReplayPolicy(recorded.actions, space, "replay", recorded.action_hz)
        start = RolloutStart(recorded.index, recorded.seed, {}, state_from_json(recorded.initial))
        done = rollout(opened.task, start, policy, opened.world, opened.judge, trace=True)
        return done.digest, done.steps, state_arrays(done.trace)
    except SimfoundryError as error:
        return error


def state_arrays(trace: tuple[tuple[SceneState, Mapping[str, RobotReading]], ...]) -> dict[str, Array]:
    """Return states as arrays whose first axis is time, keyed like observations.

    ``motions`` contains the poses of ball and free joints, and ``ROBOT/model`` the positions of all joints of a robot.
    """
    states = [state for state, _ in trace]
    found: dict[str, Array] = {
        "objects": np.array([[pose_numbers(pose) for pose in state.poses.values()] for state in states]),
        "joints": np.array([list(state.joints.values()) for state in states], dtype=np.float64),
        "motions": np.array([[pose_numbers(pose) for pose in state.motions.values()] for state in states]),
    }
    for name in trace[0][1]:
        readings = [robots[name] for _, robots in trace]
        found[f"{name}/joints"] = np.array([reading.joints for reading in readings])
        found[f"{name}/gripper"] = np.array([[reading.gripper] for reading in readings])
        found[f"{name}/hand"] = np.array([pose_numbers(reading.X_WH) for reading in readings])
        found[f"{name}/model"] = np.array([list(state.robots[name].values()) for state in states])
    return found


class OpenTask:
    """A task with its world, its judge and the initial states that were found so far."""

    def __init__(self, document: Path) -> None:
        self.task: Task = load_task(document, Cache.default())
        self.world: World = open_world(self.task.scene, ENGINE)
        self.judge = Judge(self.task.scene)
        self._searches: dict[int, StartSearch] = {}

    def start(self, seed: int, index: int) -> RolloutStart:
        """Return an initial state."""
        if seed not in self._searches:
            self._searches[seed] = StartSearch(self.task, seed, Cache.default(), (self.world, self.judge))
        return self._searches[seed].first(index + 1)[index]

    def policy(self, contender: Contender) -> Policy:
        """Return the policy, which is created on first use."""
        return _Process.policies.policy(contender, self.task, self.judge)


class _Process:
    """State that a process keeps between attempts: the open task, the policies, and the process that replays."""

    opened: tuple[Path, OpenTask] | None = None
    policies = OpenPolicies()
    verifier: Worker | None = None


def open_task(document: Path) -> OpenTask:
    """Return the task that this process keeps open; another one is closed."""
    if _Process.opened is None or _Process.opened[0] != document:
        _close_task()
        _Process.opened = document, OpenTask(document)
    return _Process.opened[1]


def _verifier() -> Worker:
    """Return the process that replays what this process recorded."""
    if _Process.verifier is None:
        _Process.verifier = Worker(LIMITS.on_machine(1))
    return _Process.verifier


def close() -> None:
    """Close the policy, the world and the replaying process of this process."""
    _Process.policies.close()
    _close_task()
    if _Process.verifier is not None:
        _Process.verifier.close(GRACE_S)
        _Process.verifier = None


def _close_task() -> None:
    if _Process.opened is not None:
        _Process.opened[1].world.close()
        _Process.opened = None


def is_answered(attempt: Attempt) -> bool:
    """Return True if the policy responded, even if the response was invalid."""
    return bool(attempt.about["end"] != RolloutEnd.NO_ANSWER)
