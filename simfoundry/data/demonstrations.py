"""Read recorded demonstrations, and replay them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, overload

from simfoundry.data.attempt import ENGINE
from simfoundry.data.record import INDEX, read_index, shard_files
from simfoundry.data.shards import Attempt, read_shard
from simfoundry.errors import OutputError, SimfoundryError
from simfoundry.evaluate.resets.starts import RolloutStart, key_of_starts, state_from_json
from simfoundry.evaluate.rollouts.control import Execution
from simfoundry.evaluate.task import Task, load_task
from simfoundry.geometry.frames import Array
from simfoundry.scene.state import SceneState
from simfoundry.spec.models.signals import ActionSpace
from simfoundry.worlds import open_world
from simfoundry.worlds.base import World


@dataclass(frozen=True, eq=False)
class Demonstration:
    """A successful rollout.

    Attributes:
        index: The index of its initial state.
        seed: The seed of the initial states.
        start: The initial state.
        actions: The actions that were executed, float64, shape (actions, action size).
        action_space: The meaning of the actions.
        action_hz: The number of actions per second [Hz].
        states: Arrays in float64 whose first axis is time: the state at the start and after each control step of the
            task. ``docs/demonstrations.md`` lists them.
        steps: The number of control steps.
        subtasks: The step at which each sub-task was completed, counted from 1, or None if it was not completed.
        trajectory: The digest of the trajectory, which a replay reproduces.
    """

    index: int
    seed: int
    start: RolloutStart
    actions: Array
    action_space: ActionSpace
    action_hz: float
    states: Mapping[str, Array]
    steps: int
    subtasks: Mapping[str, int | None]
    trajectory: str

    @classmethod
    def of(cls, attempt: Attempt) -> Demonstration:
        """Return the demonstration that a shard contains."""
        about, arrays = attempt.about, dict(attempt.arrays)
        cells = {name: (int(i), int(j)) for name, (i, j) in about["cells"].items()}
        start = RolloutStart(attempt.index, int(about["seed"]), cells, state_from_json(about["initial"]))
        actions = arrays.pop("actions")
        if actions.ndim != 2 or any(len(array) != int(about["steps"]) + 1 for array in arrays.values()):
            raise ValueError("the arrays have the wrong length")
        return cls(
            index=attempt.index,
            seed=int(about["seed"]),
            start=start,
            actions=actions,
            action_space=ActionSpace.parse(about["action_space"]),
            action_hz=float(about["action_hz"]),
            states=arrays,
            steps=int(about["steps"]),
            subtasks=dict(about["subtasks"]),
            trajectory=str(about["trajectory"]),
        )


class DemonstrationSet(Sequence[Demonstration]):
    """The demonstrations in a folder that ``simfoundry record`` wrote.

    Shards are read when they are needed. ``about`` contains the task, instruction, policy, seed, versions and the names
    of objects and joints.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.about: Mapping[str, Any] = read_index(folder / INDEX)
        self._places = [
            (path, attempt.index) for path in shard_files(folder) for attempt in read_shard(path) if attempt.is_kept
        ]
        self._last: tuple[Path, dict[int, Demonstration]] | None = None

    def __len__(self) -> int:
        """Return the number of demonstrations."""
        return len(self._places)

    @overload
    def __getitem__(self, k: int) -> Demonstration: ...
    @overload
    def __getitem__(self, k: slice) -> list[Demonstration]: ...
    def __getitem__(self, k: int | slice) -> Demonstration | list[Demonstration]:
        """Return the k-th demonstration, counted from 0."""
        if isinstance(k, slice):
            return [self[i] for i in range(*k.indices(len(self)))]
        path, index = self._places[k]
        if self._last is None or self._last[0] != path:
            self._last = path, _read(path)
        return self._last[1][index]

    @cached_property
    def task(self) -> Task:
        """The task in which the demonstrations were recorded.

        Raises:
            OutputError: If the scene, the goal or the initial states have changed since.
        """
        task = load_task((self.folder / str(self.about["document"])).resolve())
        if key_of_starts(task, int(self.about["seed"])) != self.about["starts"]:
            raise OutputError(
                f"task `{task.name}` or its scene has changed since {self.folder} was recorded; "
                "restore the documents, or record again"
            )
        return task

    def open(self) -> World:
        """Open a world in which the demonstrations can be replayed."""
        return open_world(self.task.scene, ENGINE)

    def replay(self, demonstration: Demonstration, world: World) -> Iterator[SceneState]:
        """Execute a demonstration, and yield the state at the start and after each control step.

        At each of these moments, images of any size can be rendered: ``world.render("wrist", 320, 180)``.
        """
        task = self.task
        world.reset(demonstration.start.state)
        yield world.state()
        rate = demonstration.action_hz
        execution = Execution(world, task.robots, demonstration.action_space, task.control_hz, rate)
        for action in demonstration.actions:
            for _ in execution.act(action):
                yield world.state()


def _read(path: Path) -> dict[int, Demonstration]:
    try:
        return {attempt.index: Demonstration.of(attempt) for attempt in read_shard(path) if attempt.is_kept}
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise OutputError(f"{path} does not contain valid demonstrations: {error}") from None


def read_demonstrations(folder: Path) -> DemonstrationSet:
    """Open the demonstrations in a folder.

    Raises:
        SimfoundryError: If the folder does not contain demonstrations.
    """
    if not folder.is_dir():
        raise SimfoundryError(f"{folder} is not a folder of demonstrations")
    return DemonstrationSet(folder)
