"""Recordings to scrub: rollouts of `simfoundry eval`, and demonstrations of `simfoundry record`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from simfoundry.data.demonstrations import read_demonstrations
from simfoundry.data.index import INDEX
from simfoundry.errors import SimfoundryError
from simfoundry.evaluate.statistics.records import is_result, read_all
from simfoundry.scene.model import SceneObject
from simfoundry.scene.state import SceneState
from simfoundry.studio.acts.act import resolved_path
from simfoundry.studio.reading import StudioScene
from simfoundry.studio.trial.states import states_of_arrays

# Maximum number of recordings of a folder that are listed; a list is scrolled.
MAX_LISTED = 1000


@dataclass(frozen=True, eq=False)
class Recording:
    """A recording that can be shown.

    Attributes:
        label: What it is, in one line.
        folder: The folder of a demonstration, or empty.
        number: The number of a demonstration in its folder.
        record: The record of a rollout of `simfoundry eval`, or an empty mapping for a demonstration.
        actions: The file of the rollout's actions.
    """

    label: str
    folder: Path
    number: int = 0
    record: Mapping[str, Any] | None = None
    actions: Path | None = None


def inside_project(root: Path, text: str) -> Path:
    """Return the path of a folder that a person has named, relative to the project.

    Raises:
        SimfoundryError: If there is no such folder in the project.
    """
    path = resolved_path(root / text.strip())
    if not path.is_relative_to(root):
        raise SimfoundryError(f"`{text}` is outside of the project {root}, and is not read here")
    if not path.is_dir():
        raise SimfoundryError(f"`{text}` is not a folder in the project {root}")
    return path


def find_recordings(folder: Path, scene: StudioScene) -> tuple[Recording, ...]:
    """Return the recordings of a task in a folder.

    Raises:
        SimfoundryError: If the folder contains no recordings, or only those of other tasks.
    """
    if scene.task is None:
        raise SimfoundryError("recordings are of a task; open the task document instead of its scene")
    if (folder / INDEX).is_file():
        found, others = _demonstrations(folder, scene)
    elif (folder / "rollouts").is_dir():
        found, others = _rollouts(folder, scene.task.name)
    else:
        raise SimfoundryError(
            f"{folder} contains neither rollouts of `simfoundry eval` nor demonstrations of `simfoundry record`"
        )
    if not found:
        what = f"those of {', '.join(sorted(others))}" if others else "no rollout that can be replayed"
        raise SimfoundryError(f"{folder} contains no recordings of the task `{scene.task.name}`: only {what}")
    return tuple(found[:MAX_LISTED])


def _demonstrations(folder: Path, scene: StudioScene) -> tuple[list[Recording], set[str]]:
    demonstrations = read_demonstrations(folder)
    found, others, own = [], set[str](), resolved_path(scene.root.path)
    for k, head in enumerate(demonstrations.heads):
        facts = demonstrations.facts(k)
        if resolved_path(folder / str(facts["document"])) == own:
            found.append(Recording(f"demonstration {head['index']}, {head['steps']} steps", folder, k))
        else:
            others.add(str(facts["document"]))
    return found, others


def _rollouts(folder: Path, task: str) -> tuple[list[Recording], set[str]]:
    found, others = [], set[str]()
    for path, record in read_all(folder):
        if record.get("task") != task:
            others.add(str(record.get("task")))
        elif is_result(record) and (actions := path.with_suffix(".npz")).is_file():
            outcome = "success" if record["success"] else f"failure ({record['end']})"
            part = f" {record['step']}" if record.get("step") else ""
            where = f"{record.get('policy')} in {record.get('engine')}"
            found.append(Recording(f"{path.stem}{part}: {where}, {outcome}", folder, 0, record, actions))
    return found, others


def demonstration_states(
    recording: Recording, scene: StudioScene, robots: Sequence[SceneObject]
) -> tuple[list[SceneState], float]:
    """Return the states of a demonstration, and their number per second [Hz].

    Raises:
        SimfoundryError: If the demonstration does not fit the scene.
    """
    demonstration = read_demonstrations(recording.folder)[recording.number]
    names = list(demonstration.about["objects"])
    if set(names) != set(scene.objects):
        raise SimfoundryError(
            f"the demonstration was recorded with {', '.join(names)}, but the scene has {', '.join(scene.objects)}"
        )
    joints = {item.name: tuple(joint.name for joint in item.joints if joint.has_axis) for item in robots}
    try:
        states = states_of_arrays(demonstration.about, demonstration.states, joints)
    except (ValueError, KeyError, IndexError) as error:
        raise SimfoundryError(f"the demonstration does not fit the scene or its robots: {error}") from None
    return states, float(demonstration.about["control_hz"])
