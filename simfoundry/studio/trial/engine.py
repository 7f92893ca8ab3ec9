"""Code for the process of a trial: physics that advances in short pieces, and whole rollouts.

Functions here are called by name in a :class:`~simfoundry.runtime.workers.Worker`. They take and return plain data, and
return errors for people, because workers report exceptions without their type.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import numpy as np

from simfoundry.assets.cache import Cache
from simfoundry.errors import SimfoundryError
from simfoundry.evaluate.entries import Contender, create_policy
from simfoundry.evaluate.policies.base import Policy
from simfoundry.evaluate.resets.starts import RolloutStart, starts
from simfoundry.evaluate.rollouts.rollout import rollout
from simfoundry.evaluate.task import Task, need_robots, task_of
from simfoundry.predicates import Judge
from simfoundry.runtime.workers import at_worker_exit, report_progress
from simfoundry.scene.lower import lower
from simfoundry.scene.model import Scene
from simfoundry.scene.state import SceneState
from simfoundry.spec.diagnostics import SpecError
from simfoundry.spec.files import Loaded
from simfoundry.spec.models.task import TaskSpec
from simfoundry.spec.open_documents import OpenDocuments
from simfoundry.studio.trial.states import state_data, state_of
from simfoundry.worlds import open_world
from simfoundry.worlds.base import World
from simfoundry.worlds.settle import settle

P = ParamSpec("P")
T = TypeVar("T")


@dataclass(frozen=True)
class TrialDocument:
    """The document to try, with the texts of a session, which need not be saved."""

    path: Path
    texts: Mapping[Path, str]

    def load(self) -> Loaded:
        """Load the document.

        Raises:
            SpecError: If it has errors.
        """
        documents = OpenDocuments()
        for path, text in self.texts.items():
            documents.edit(path, text)
        loaded = documents.load(self.path)
        if loaded.errors:
            raise SpecError(loaded.errors)
        return loaded


@dataclass(frozen=True)
class Push:
    """A force [N] on a link, at a point [m], both in the world frame."""

    link: str
    force: tuple[float, float, float]
    point: tuple[float, float, float]


def _answering(function: Callable[P, T]) -> Callable[P, T | SimfoundryError]:
    """Return a function that returns errors for people instead of raising them."""

    @wraps(function)
    def answer(*args: P.args, **kwargs: P.kwargs) -> T | SimfoundryError:
        try:
            return function(*args, **kwargs)
        except (SimfoundryError, OSError) as error:
            return SimfoundryError(str(error))
        except KeyError as error:
            return SimfoundryError(str(error.args[0] if error.args else error))

    return answer


# -- physics -----------------------------------------------------------------------------------------------------------


class _Open:
    """The world that is open in this process."""

    world: World | None = None


@_answering
def begin(document: TrialDocument, engine: str) -> dict[str, Any]:
    """Open a world of the document's scene, and return its state."""
    at_worker_exit(close)
    close()
    loaded = document.load()
    cache = Cache.default()
    scene: Scene = (
        task_of(loaded, cache).scene if isinstance(loaded.spec, TaskSpec) else lower(loaded, cache, fetch=False)
    )
    _Open.world = open_world(scene, engine)
    return state_data(_Open.world.state())


def close() -> None:
    """Close the world, if one is open."""
    if _Open.world is not None:
        _Open.world.close()
        _Open.world = None


@_answering
def advance(seconds: float, pushes: Sequence[Push] = ()) -> dict[str, Any]:
    """Advance physics by at least one step, with forces that act meanwhile, and return the state."""
    world = _world()
    for push in pushes:
        world.push(push.link, np.array(push.force), np.array(push.point))
    world.step(max(1, round(seconds / world.timestep)))
    if trouble := world.trouble():
        raise SimfoundryError(trouble)
    return state_data(world.state())


@_answering
def reset(state: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Reset to a state, or to the initial one, with zero velocities, and return the state."""
    world = _world()
    world.reset(None if state is None else state_of(state))
    return state_data(world.state())


@_answering
def settle_objects() -> dict[str, Any]:
    """Settle all objects from their present poses. Returns the state, and a sentence for each object with a problem."""
    world = _world()
    found = settle(world, state=world.state(), progress=lambda stage, share: report_progress(f"{stage} {share:.0%}"))
    problems = [f"`{each.name}` {', '.join(each.problems)}" for each in found.objects if each.problems]
    return {"state": state_data(world.state()), "problems": problems, "lost": list(found.lost)}


def _world() -> World:
    if _Open.world is None:
        raise SimfoundryError("physics has not been started")
    return _Open.world


# -- rollouts ----------------------------------------------------------------------------------------------------------


@_answering
def run_policy(document: TrialDocument, policy: str, index: int, seed: int, engine: str) -> dict[str, Any]:
    """Run a policy from an initial state of a task. Each state is reported as progress while it runs."""
    task = _task(document)
    judge = Judge(task.scene)
    report_progress(_message("says", "searching for the initial state"))
    start = starts(task, index + 1, seed, Cache.default())[index]
    report_progress(_message("says", "starting the policy"))
    created = create_policy(Contender("policy", policy).choice(), task, judge)
    try:
        return _rollout(task, start, created, engine, judge)
    finally:
        created.close()


@_answering
def run_recorded(document: TrialDocument, record: Mapping[str, Any], actions: Path) -> dict[str, Any]:
    """Replay a rollout of `simfoundry eval` from its record and its actions, as :func:`run_policy` does."""
    from simfoundry.evaluate.policies.open_loop import load_replay

    task = _task(document)
    part, step = record.get("part", "whole"), record.get("step", "")
    if part != "whole":
        task = task.alone(step) if part == "alone" else task.onward(step)
    if record["task"] != task.name:
        raise SimfoundryError(f"the recording is of the task `{record['task']}`, not of `{task.name}`; open that task")
    index = int(record["index"])
    report_progress(_message("says", "searching for the initial state"))
    start = starts(task, index + 1, int(record["seed"]), Cache.default())[index]
    done = _rollout(task, start, load_replay(actions), str(record.get("engine", "mujoco")), Judge(task.scene))
    return {**done, "is_identical": done["digest"] == record.get("trajectory")}


def _task(document: TrialDocument) -> Task:
    loaded = document.load()
    if not isinstance(loaded.spec, TaskSpec):
        raise SimfoundryError("policies need a task; open the task document instead of its scene")
    task = task_of(loaded, Cache.default())
    need_robots(task)
    return task


def _rollout(task: Task, start: RolloutStart, policy: Policy, engine: str, judge: Judge) -> dict[str, Any]:
    report_progress(_message("hz", task.control_hz))
    with open_world(task.scene, engine) as world:
        done = rollout(task, start, policy, world, judge, watch=_report_state)
    return {"success": done.success, "reason": done.reason, "steps": done.steps, "digest": done.digest}


def _report_state(state: SceneState) -> None:
    report_progress(_message("state", state_data(state)))


def _message(kind: str, content: Any) -> str:
    return json.dumps({kind: content})
