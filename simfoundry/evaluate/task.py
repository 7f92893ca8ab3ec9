"""A task that is prepared for rollouts.

It consists of the scene in the task's initial state, the robots, and the steps as separate tasks. The `start` of the
task is applied to the scene document first, followed by the `start` of the step, if any.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import dropwhile
from pathlib import Path

from simfoundry.assets.cache import Cache
from simfoundry.backends.robot_models.control import check_can_act
from simfoundry.errors import SimfoundryError
from simfoundry.scene.lower import lower
from simfoundry.scene.model import Scene
from simfoundry.scene.task_start import placed_in_task
from simfoundry.spec.diagnostics import SpecError, nearest
from simfoundry.spec.files import Loaded
from simfoundry.spec.load import load_kind
from simfoundry.spec.models.disturbances import Disturbances
from simfoundry.spec.models.predicate import Condition, parse_call
from simfoundry.spec.models.scene import ObjectSpec, SceneSpec
from simfoundry.spec.models.task import Reset, Start, TaskSpec, with_starts


@dataclass(frozen=True, eq=False)
class TaskSetup:
    """The documents of a ``task`` and its ``scene``.

    ``step`` is the step at which the task starts, or an empty string for the first step.
    """

    task: Loaded
    scene: Loaded
    step: str = ""
    cache: Cache | None = None

    @property
    def task_spec(self) -> TaskSpec:
        """The task document."""
        assert isinstance(self.task.spec, TaskSpec)
        return self.task.spec

    @property
    def scene_spec(self) -> SceneSpec:
        """The scene document."""
        assert isinstance(self.scene.spec, SceneSpec)
        return self.scene.spec

    @property
    def own_start(self) -> Start | None:
        """The start that is defined by the step itself.

        The value is None if the step does not define a start.
        """
        return self.task_spec.subtasks[self.step].start if self.step else None

    @property
    def starts(self) -> dict[tuple[str, ...], Start]:
        """The changes to the scene, in the order in which they are applied.

        The keys are the paths of the changes in the task.
        """
        own = self.own_start
        return {("start",): self.task_spec.start} | ({("subtasks", self.step, "start"): own} if own else {})

    @cached_property
    def started(self) -> SceneSpec:
        """The scene document after applying the starts.

        Relations that the starts may invalidate are removed, and relations for the new placements are added.
        """
        spec, starts = with_starts(self.scene_spec, self.starts.values()), self.starts.values()
        moved = {name for start in starts for name in (*start.place, *start.pose)}
        turned = {name for start in starts for name in start.joints}
        kept = [text for text in self.scene_spec.relations if not _is_undone(text, moved, turned)]
        stood = [f"OnTop({name}, {support})" for name in sorted(moved) if (support := _carrier(spec.objects[name]))]
        return spec.model_copy(update={"relations": (*kept, *stood)})

    def lowered(self) -> Scene:
        """Lower the scene in the task's initial state.

        Raises:
            SpecError: If the scene is invalid. Errors caused by the task's start refer to locations in the task.
        """
        try:
            return lower(replace(self.scene, spec=self.started), self.cache)
        except SpecError as error:
            found = [placed_in_task(self.task, self.starts, self.started, d) for d in error.diagnostics]
            raise SpecError(found) from None

    def carriers(self) -> dict[str, str]:
        """Return the support of each object, keyed by object name.

        Objects for which the documents do not specify a support are omitted.
        """
        calls = [parse_call(text) for text in self.started.relations]
        found = {c.args[0]: c.args[1].partition(".")[0] for c in calls if c.predicate in ("OnTop", "Inside")}
        placed = {name: _carrier(item) for name, item in self.started.objects.items()}
        return found | {name: carrier for name, carrier in placed.items() if carrier}


def _carrier(item: ObjectSpec) -> str:
    place = item.place
    return ((place.on or place.inside or "") if place else "").partition(".")[0]


def _is_undone(relation: str, moved: set[str], turned: set[str]) -> bool:
    """Return True if moving the given objects or their joints may break a relation."""
    call = parse_call(relation)
    names = {argument.partition(".")[0] for argument in call.args}
    return bool(names & moved) or (call.predicate in ("Open", "Closed") and bool(names & turned))


@dataclass(frozen=True, eq=False)
class SubtaskGoal:
    """A step of a task.

    ``instruction`` is used if the step is run alone. ``starts_itself`` is True if the step defines a start.
    """

    name: str
    goal: Condition
    instruction: str
    starts_itself: bool


@dataclass(frozen=True, eq=False)
class Task:
    """A task in its lowered scene, in the initial state of the task.

    Attributes:
        robots: The robots that act, in the order in which their values appear in an action.
        subtasks: The steps, in the order of the document.
        reset: The regions of the objects whose initial pose varies.
        carriers: The support of each object, keyed by object name. An object moves together with its support.
        control_hz: The control frequency [Hz].
        horizon: The maximum number of control steps.
        disturbances: The latency and noise of actions and observations.
        step: The sub-task that this task represents, or an empty string for the whole task.
    """

    name: str
    scene: Scene
    instruction: str
    robots: tuple[str, ...]
    goal: Condition
    subtasks: Mapping[str, SubtaskGoal]
    reset: Reset
    carriers: Mapping[str, str]
    control_hz: float
    horizon: int
    setup: TaskSetup
    disturbances: Disturbances = field(default_factory=Disturbances)
    step: str = ""

    @cached_property
    def missing_robots(self) -> Mapping[str, str]:
        """The robots that should act but whose model was not found, with the reason for each robot."""
        known = {robot.name for robot in self.scene.robots}
        reasons = {left.path.removeprefix("robots."): left.reason for left in self.scene.left_out}
        return {name: reasons.get(name, "no model found") for name in self.robots if name not in known}

    def alone(self, name: str) -> Task:
        """Return a single step as a separate task with the initial state and goal of that step.

        Objects that the step's ``start`` places keep that placement. All other objects are placed in their cells.

        Raises:
            SimfoundryError: If the step does not exist.
        """
        step = self._subtask(name)
        return replace(self._from(name), instruction=step.instruction, goal=step.goal, subtasks={name: step})

    def onward(self, name: str) -> Task:
        """Return the rest of the task from a given step onward.

        The goal is that of the whole task.

        Raises:
            SimfoundryError: If the step does not exist.
        """
        self._subtask(name)
        rest = dropwhile(lambda entry: entry[0] != name, self.subtasks.items())
        return replace(self._from(name), subtasks=dict(rest))

    def _subtask(self, name: str) -> SubtaskGoal:
        if name not in self.subtasks:
            hint = nearest(name, self.subtasks) or "it has no sub-tasks"
            raise SimfoundryError(f"task `{self.name}` has no sub-task `{name}`; {hint}")
        return self.subtasks[name]

    def _from(self, name: str) -> Task:
        setup = replace(self.setup, step=name)
        own = setup.own_start
        put = {*own.place, *own.pose} if own else set()
        reset = self.reset.model_copy(update={"objects": {n: r for n, r in self.reset.objects.items() if n not in put}})
        return replace(self, scene=setup.lowered(), reset=reset, carriers=setup.carriers(), setup=setup, step=name)


def load_task(path: Path, cache: Cache | None = None) -> Task:
    """Load a task from its document.

    Args:
        path: The task document.
        cache: A cache that stores convex decompositions between runs.

    Raises:
        SpecError: If the task or its scene is invalid. The error contains all findings.
    """
    return task_of(load_kind(path, "task/1"), cache)


def task_of(loaded: Loaded, cache: Cache | None = None) -> Task:
    """Lower the scene of a task document, and return the task; see :func:`load_task`.

    Raises:
        SpecError: If the scene is invalid. The error contains all findings.
    """
    spec = loaded.spec
    assert isinstance(spec, TaskSpec)
    scene = loaded.used(spec.scene)
    if scene is None:
        raise SpecError([loaded.finding("SF005", ("scene",), f"`{spec.scene}` is not a readable scene")])
    setup = TaskSetup(loaded, scene, cache=cache)
    steps = spec.subtasks.items()
    return Task(
        name=spec.name,
        scene=setup.lowered(),
        instruction=spec.instruction,
        robots=spec.robots or tuple(setup.scene_spec.robots),
        goal=spec.goal,
        subtasks={n: SubtaskGoal(n, s.goal, s.instruction or spec.instruction, s.start is not None) for n, s in steps},
        reset=spec.reset,
        carriers=setup.carriers(),
        control_hz=spec.control_hz,
        horizon=spec.horizon,
        setup=setup,
        disturbances=spec.disturbances,
    )


def need_robots(task: Task) -> None:
    """Check that all robots that should act are present and can be controlled.

    Raises:
        SimfoundryError: If a robot is missing or cannot be controlled.
    """
    if not task.robots:
        raise SimfoundryError(f"task `{task.name}` needs a robot, but its scene does not contain any")
    for name, reason in task.missing_robots.items():
        raise SimfoundryError(f"task `{task.name}` needs robot `{name}`, which is not available: {reason}")
    for name in task.robots:
        check_can_act(task.scene.robot(name))
