"""Read recorded demonstrations, and replay them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, overload

from simfoundry.data.attempt import ENGINE
from simfoundry.data.index import INDEX, TASKS, facts_of_tasks, read_index
from simfoundry.data.shards import Attempt, read_shard
from simfoundry.data.store import read_shards
from simfoundry.errors import OutputError, SimfoundryError
from simfoundry.evaluate.resets.starts import RolloutStart, key_of_starts, state_from_json
from simfoundry.evaluate.rollouts.execution import Execution, check_rate
from simfoundry.evaluate.task import Task, load_task
from simfoundry.geometry.frames import Array
from simfoundry.scene.state import SceneState
from simfoundry.spec.models.signals import ActionSpace
from simfoundry.spec.yaml.write import to_data
from simfoundry.worlds import open_world
from simfoundry.worlds.base import World


@dataclass(frozen=True)
class SubtaskMark:
    """A moment that a person marked as the end of a sub-task.

    Attributes:
        name: The name of the sub-task. The marks of an attempt stand for the sub-tasks of the task in their order; the
            name is empty if there are more marks than sub-tasks.
        step: The number of control steps before the mark.
    """

    name: str
    step: int


@dataclass(frozen=True, eq=False)
class Demonstration:
    """A successful rollout.

    Attributes:
        index: The index of the attempt. With a single task, it is also the index of the initial state.
        document: The task document.
        about: The facts that all demonstrations of the task share, such as its instruction and the names of objects and
            joints in the order of the arrays; see ``docs/demonstrations.md``.
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
        origin: Where the actions come from, such as the demonstration of each segment of an augmented one; empty if the
            policy does not state it.
        device: The device of the person who gave the demonstration, or an empty string for a policy.
        marks: The sub-tasks that the person marked, in order.
    """

    index: int
    document: Path
    about: Mapping[str, Any]
    seed: int
    start: RolloutStart
    actions: Array
    action_space: ActionSpace
    action_hz: float
    states: Mapping[str, Array]
    steps: int
    subtasks: Mapping[str, int | None]
    trajectory: str
    origin: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))
    device: str = ""
    marks: tuple[SubtaskMark, ...] = ()

    @classmethod
    def of(cls, attempt: Attempt, folder: Path, tasks: Sequence[Mapping[str, Any]]) -> Demonstration:
        """Return the demonstration that a shard contains.

        Args:
            attempt: The attempt.
            folder: The folder of the recording.
            tasks: The facts of each task, in the order in which they take turns.
        """
        said, arrays = attempt.about, dict(attempt.arrays)
        start, turn = divmod(attempt.index, len(tasks))
        about = tasks[turn]
        if len(tasks) > 1 and said["document"] != about["document"]:
            raise ValueError(f"attempt {attempt.index} belongs to {said['document']}, not to {about['document']}")
        cells = {name: (int(i), int(j)) for name, (i, j) in said["cells"].items()}
        made = cls(
            index=attempt.index,
            document=(folder / str(about["document"])).resolve(),
            about=about,
            seed=int(said["seed"]),
            start=RolloutStart(start, int(said["seed"]), cells, state_from_json(said["initial"])),
            actions=arrays.pop("actions"),
            action_space=ActionSpace.parse(said["action_space"]),
            action_hz=float(said["action_hz"]),
            states=arrays,
            steps=int(said["steps"]),
            subtasks=dict(said["subtasks"]),
            trajectory=str(said["trajectory"]),
            origin=dict(said.get("origin", {})),
            device=str(said.get("device", "")),
            marks=tuple(SubtaskMark(str(mark["name"]), int(mark["step"])) for mark in said.get("marks", ())),
        )
        _check(made)
        return made

    def load_task(self) -> Task:
        """Load the task in which the demonstration was recorded.

        Raises:
            OutputError: If the scene, the goal, the initial states, the control frequency or the noise and latency of
                actions have changed since.
        """
        task = load_task(self.document)
        action = self.about["disturbances"].get("action", {})  # noise of observations does not affect a replay
        wanted = (key_of_starts(task, self.seed), task.control_hz, to_data(task.disturbances.action))
        if wanted != (self.about["starts"], self.about["control_hz"], action):
            raise OutputError(
                f"task `{task.name}` or its scene has changed since the demonstrations in it were recorded; restore "
                f"{self.document} and its scene, or record again"
            )
        return task


def _check(made: Demonstration) -> None:
    """Check that a demonstration fits its task.

    Raises:
        ValueError: If its arrays or its initial state do not.
        SimfoundryError: If its control frequency is not valid.
    """
    about, state, hz = made.about, made.start.state, made.action_hz
    named = {"objects": state.poses, "joints": state.joints, "motions": state.motions}
    if any(list(about[key]) != list(names) for key, names in named.items()):
        raise ValueError("an initial state does not have the objects and joints of the task")
    sizes = {robot: made.states[f"{robot}/joints"].shape[-1] for robot in about["robots"]}
    shapes: dict[str, tuple[int, ...]] = {
        "objects": (len(state.poses), 7),
        "joints": (len(state.joints),),
        "motions": (len(state.motions), 7) if state.motions else (0,),
    }
    for robot, joints in sizes.items():
        model = made.states[f"{robot}/model"].shape[1:2]
        shapes |= {f"{robot}/joints": (joints,), f"{robot}/gripper": (1,), f"{robot}/hand": (7,)}
        shapes[f"{robot}/model"] = model or (0,)
    if unknown := sorted(made.states.keys() - shapes.keys()):
        raise ValueError(f"the array `{unknown[0]}` is unknown")
    for name, shape in shapes.items():
        if made.states[name].shape != (made.steps + 1, *shape):
            raise ValueError(f"the shape of `{name}` is {made.states[name].shape}, not {(made.steps + 1, *shape)}")
    width = sum(made.action_space.arm_size(joints) + 1 for joints in sizes.values())
    if made.actions.ndim != 2 or made.actions.shape[1] != width:
        raise ValueError(f"the shape of `actions` is {made.actions.shape}, not (actions, {width})")
    check_rate(hz, "a demonstration")
    step = 1 / float(about["control_hz"])  # [s]; actions start at the next physics step, so this is approximate
    if not (len(made.actions) - 1) / hz - step <= made.steps * step <= len(made.actions) / hz + step:
        raise ValueError("its actions do not last as long as its states")


class DemonstrationSet(Sequence[Demonstration]):
    """The demonstrations in a folder that ``simfoundry record`` wrote.

    Arrays are read when they are needed.

    Attributes:
        folder: The folder.
        about: The facts that all tasks share: the policy, seed and versions, and with a single task also those in
            :attr:`Demonstration.about`.
        tasks: The facts of each task.
        heads: The entry of each demonstration in its shard: what it contains except for its arrays.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        index = read_index(folder / INDEX)
        self.tasks: tuple[Mapping[str, Any], ...] = tuple(facts_of_tasks(index))
        self.about: Mapping[str, Any] = {key: value for key, value in index.items() if key != TASKS}
        shards = read_shards(folder, with_arrays=False)
        kept = [(path, one.about) for path, attempts in shards for one in attempts if one.is_kept]
        self._places = [(path, int(about["index"])) for path, about in kept]
        self.heads: tuple[Mapping[str, Any], ...] = tuple(about for _, about in kept)
        self._last: tuple[Path, dict[int, Demonstration]] | None = None
        self._loaded: tuple[Path, Task] | None = None

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
            self._last = path, self._read(path)
        return self._last[1][index]

    def facts(self, k: int) -> Mapping[str, Any]:
        """Return the facts that the k-th demonstration shares with all others of its task."""
        return self.tasks[int(self.heads[k]["index"]) % len(self.tasks)]

    def _read(self, path: Path) -> dict[int, Demonstration]:
        kept = [attempt for attempt in read_shard(path) if attempt.is_kept]
        try:
            return {attempt.index: Demonstration.of(attempt, self.folder, self.tasks) for attempt in kept}
        except KeyError as error:
            raise OutputError(f"{path} does not contain valid demonstrations: `{error.args[0]}` is missing") from None
        except (ValueError, TypeError, AttributeError, SimfoundryError) as error:
            raise OutputError(f"{path} does not contain valid demonstrations: {error}") from None

    def task_of(self, demonstration: Demonstration) -> Task:
        """Return the task of a demonstration, which stays loaded while successive demonstrations share it.

        Raises:
            OutputError: If the scene, the goal, the initial states, the control frequency or the noise and latency of
                actions have changed since.
        """
        if self._loaded is None or self._loaded[0] != demonstration.document:
            self._loaded = demonstration.document, demonstration.load_task()
        return self._loaded[1]

    @property
    def task(self) -> Task:
        """The task in which the demonstrations were recorded.

        Raises:
            OutputError: If the folder contains demonstrations of several tasks or none at all, or if the scene, the
                goal or the initial states have changed since.
        """
        if len(self.tasks) > 1:
            raise OutputError(f"{self.folder} contains {len(self.tasks)} tasks; use `task_of` to load one of them")
        if not self._places:
            raise OutputError(f"{self.folder} does not contain any demonstrations yet; repeat the recording")
        return self.task_of(self[0])

    def open(self, demonstration: Demonstration | None = None) -> World:
        """Open a world in which a demonstration can be replayed; by default, that of the only task."""
        return open_world((self.task if demonstration is None else self.task_of(demonstration)).scene, ENGINE)

    def replay(self, demonstration: Demonstration, world: World) -> Iterator[SceneState]:
        """Execute a demonstration, and yield the state at the start and after each control step.

        At each of these moments, images of any size can be rendered: ``world.render("wrist", 320, 180)``.
        """
        task, start = self.task_of(demonstration), demonstration.start
        world.reset(start.state)
        yield world.state()
        rates, about = (task.control_hz, demonstration.action_hz), task.disturbances.action
        seed = start.seed, start.index
        execution = Execution(world, task.robots, demonstration.action_space, *rates, about, seed)
        for action in demonstration.actions:
            for _ in execution.act(action):
                yield world.state()


def read_demonstrations(folder: Path) -> DemonstrationSet:
    """Open the demonstrations in a folder.

    Raises:
        SimfoundryError: If the folder does not contain demonstrations.
    """
    if not folder.is_dir():
        raise SimfoundryError(f"{folder} is not a folder of demonstrations")
    return DemonstrationSet(folder)
