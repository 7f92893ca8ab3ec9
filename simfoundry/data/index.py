"""The index of a recording: what its demonstrations have in common.

``demonstrations.json`` contains the facts that all tasks of the recording share. With several tasks, ``tasks`` lists
the facts of each task that differ between them.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from simfoundry import __version__
from simfoundry.assets.cache import Cache
from simfoundry.data.attempt import ENGINE
from simfoundry.data.plan import RecordPlan
from simfoundry.data.shards import FORMAT
from simfoundry.errors import OutputError, SimfoundryError
from simfoundry.evaluate.resets.starts import key_of_starts
from simfoundry.evaluate.task import load_task, need_robots
from simfoundry.runtime.files import write_atomically
from simfoundry.runtime.parallel import map_parallel
from simfoundry.scene.state import SceneState
from simfoundry.spec.models.predicate import Condition
from simfoundry.spec.yaml.write import to_data

INDEX, TASKS = "demonstrations.json", "tasks"

# The folder of the demonstrations that were augmented. It may move: the digest of the policy covers its content.
SOURCE = "source"

# Maximum size of an index to read [bytes]; one of ten thousand tasks takes about 10 MB.
MOST_BYTES = 2**26

# Names of facts in messages.
_NAMES = {
    "starts": "scene, goal or initial states (by their hash)",
    "policy_digest": "policy (its document, recording or code)",
    "engine_version": "version of MuJoCo",
}


def build_index(plan: RecordPlan) -> dict[str, Any]:
    """Load all tasks of a plan, and return its index.

    Raises:
        SimfoundryError: If a task is invalid, lacks a robot, or is listed twice.
    """
    names = [plan.name(document) for document in plan.documents]
    repeated = next((name for k, name in enumerate(names) if name in names[:k]), None)
    if repeated is not None:
        raise SimfoundryError(f"task document {repeated} is listed twice; list each document once")
    found = map_parallel(partial(_facts_or_error, plan), plan.documents)
    facts = [one for one in found if isinstance(one, dict)]
    for one in found:
        if isinstance(one, SimfoundryError):
            raise one
    first, *others = facts
    shared = {key: value for key, value in first.items() if all(other[key] == value for other in others)}
    rest = [{key: value for key, value in one.items() if key not in shared} for one in facts]
    return {**shared, TASKS: rest} if others else first


def _facts_or_error(plan: RecordPlan, document: Path) -> dict[str, Any] | SimfoundryError:
    """Return what all demonstrations of a task have in common; workers report exceptions without their type."""
    try:
        return _facts(plan, document)
    except SimfoundryError as error:
        return error


def _facts(plan: RecordPlan, document: Path) -> dict[str, Any]:
    task = load_task(document, Cache.default())
    need_robots(task)
    scene = task.scene
    initial, goals = SceneState.initial(scene), TypeAdapter(Condition)
    facts = {
        "simfoundry": FORMAT,
        "version": __version__,
        "engine": ENGINE,
        "engine_version": version(ENGINE),
        "task": task.name,
        "document": plan.name(document),
        "starts": key_of_starts(task, plan.seed),
        "seed": plan.seed,
        "policy": plan.contender.label,
        "policy_digest": plan.contender.digest,
        **({} if plan.source is None else {SOURCE: plan.name(plan.source)}),
        "instruction": task.instruction,
        "control_hz": task.control_hz,
        "horizon": task.horizon,
        "disturbances": to_data(task.disturbances),
        "robots": {name: scene.robot(name).kind for name in task.robots},
        "goal": goals.dump_python(task.goal, mode="json", by_alias=True),
        "subtasks": {name: goals.dump_python(s.goal, mode="json", by_alias=True) for name, s in task.subtasks.items()},
        "objects": list(initial.poses),
        "joints": list(initial.joints),
        "motions": list(initial.motions),
    }
    return dict(json.loads(json.dumps(facts)))  # as they are when they have been read again


def facts_of_tasks(index: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return all facts of each task, in the order in which they take turns."""
    # The first recordings did not state any disturbances.
    shared = {"disturbances": {}} | {key: value for key, value in index.items() if key != TASKS}
    return [{**shared, **rest} for rest in index.get(TASKS, [{}])]


def write_index(folder: Path, index: Mapping[str, Any]) -> None:
    """Write the index of a new recording."""
    write_atomically(folder / INDEX, (json.dumps(index, indent=1, ensure_ascii=False) + "\n").encode())


def read_index(path: Path) -> dict[str, Any]:
    """Read the index of a recording.

    Raises:
        OutputError: If the file is not such an index.
    """
    try:
        if path.stat().st_size > MOST_BYTES:
            raise ValueError
        found = json.loads(path.read_text(encoding="utf-8"))
        if found["simfoundry"] != FORMAT:
            raise ValueError
        if not found.get(TASKS, [{}]) or not all(map(_is_complete, facts_of_tasks(found))):
            raise ValueError
    except (FileNotFoundError, NotADirectoryError):
        raise OutputError(f"{path.parent} does not contain demonstrations: {path.name} is missing") from None
    except (ValueError, KeyError, TypeError, RecursionError):
        raise OutputError(f"{path} is not an index of demonstrations in the format {FORMAT}") from None
    return dict(found)


def _is_complete(facts: Mapping[str, Any]) -> bool:
    """Return True if the facts of a task contain everything that reading demonstrations requires."""
    lists = [facts[key] for key in ("objects", "joints", "motions")]
    return (
        all(isinstance(facts[key], str) for key in ("task", "document", "starts", "instruction", "policy"))
        and isinstance(facts["seed"], int)
        and isinstance(facts["robots"], dict)
        and isinstance(facts["control_hz"], int | float)
        and 0 < facts["control_hz"] < math.inf
        and all(isinstance(names, list) and all(isinstance(name, str) for name in names) for names in lists)
    )


def check_index(folder: Path, index: Mapping[str, Any], wanted: Mapping[str, Any]) -> None:
    """Compare the index of a folder with that of the recording that should continue there.

    Raises:
        OutputError: If the folder contains demonstrations of another task, policy or version.
    """
    there, mine = facts_of_tasks(index), facts_of_tasks(wanted)
    if len(there) != len(mine):
        raise OutputError(
            f"{folder} contains demonstrations of {_tasks(there)}, not of {_tasks(mine)}; choose another folder"
        )
    for old, new in zip(there, mine, strict=True):
        where = f"{folder} contains demonstrations" + (f" of {new['document']}" if len(mine) > 1 else "")
        for key, value in new.items():
            if key != SOURCE and old.get(key) != value:
                raise OutputError(
                    f"{where} with a different {_NAMES.get(key, f'`{key}`')}: {old.get(key)!r}, not {value!r}; "
                    "choose another folder"
                )


def _tasks(facts: Sequence[Mapping[str, Any]]) -> str:
    return f"{len(facts)} tasks" if len(facts) > 1 else f"the task `{facts[0]['task']}`"
