"""A task prepared for rollouts: its scene lowered as the task starts, and its steps as tasks of their own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType

from simfoundry.assets.cache import Cache
from simfoundry.errors import SimfoundryError
from simfoundry.evaluate.tasks.robots import check_can_act
from simfoundry.evaluate.tasks.setup import TaskSetup, carried_by, lowered
from simfoundry.scene.model import Scene
from simfoundry.spec.diagnostics import SpecError, nearest
from simfoundry.spec.load import load_kind
from simfoundry.spec.models.expressions import Condition
from simfoundry.spec.models.task import Reset, TaskSpec


@dataclass(frozen=True, eq=False)
class SubtaskGoal:
    """A step: ``goal``, and the instruction if the step is done alone; ``starts_itself`` if it has a start of
    its own.
    """

    name: str
    goal: Condition
    instruction: str
    starts_itself: bool


@dataclass(frozen=True, eq=False)
class Task:
    """A task in its lowered scene, in the state in which the task starts.

    ``robots`` act, in the order of an action; ``subtasks`` are in the document's order. ``reset`` has the regions of
    objects that differ from start to start; ``carriers`` maps each object to its support, with which it moves along.
    ``control_hz`` [Hz] and ``horizon`` [control steps]. ``step`` is the sub-task that this is, empty for the whole.
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
    step: str = ""

    @cached_property
    def missing_robots(self) -> Mapping[str, str]:
        """Robots that should act but have no model here, each with the reason."""
        known = {robot.name for robot in self.scene.robots}
        reasons = {left.path.removeprefix("robots."): left.reason for left in self.scene.left_out}
        return {name: reasons.get(name, "no model found") for name in self.robots if name not in known}

    def alone(self, name: str) -> Task:
        """Return one step as a task: it starts as the step's ``start`` defines and ends with the step's goal.

        Objects placed by that start stay there; the others start in their cells. Raises :class:`SimfoundryError` for an
        unknown step.
        """
        step = self._subtask(name)
        own = MappingProxyType({name: step})
        return replace(self._from(name), instruction=step.instruction, goal=step.goal, subtasks=own)

    def onward(self, name: str) -> Task:
        """Return the rest of the task from a step on: it starts like that step, and has the goal of the whole task."""
        self._subtask(name)
        names = list(self.subtasks)
        rest = {n: self.subtasks[n] for n in names[names.index(name) :]}
        return replace(self._from(name), subtasks=MappingProxyType(rest))

    def _subtask(self, name: str) -> SubtaskGoal:
        if name not in self.subtasks:
            hint = nearest(name, self.subtasks) or "it has none"
            raise SimfoundryError(f"task `{self.name}` has no sub-task `{name}`; {hint}")
        return self.subtasks[name]

    def _from(self, name: str) -> Task:
        setup = self.setup.with_step(name)
        regions = {n: region for n, region in self.reset.objects.items() if n not in setup.put_by_step}
        return replace(
            self,
            scene=lowered(setup),
            reset=self.reset.model_copy(update={"objects": regions}),
            carriers=carried_by(setup),
            setup=setup,
            step=name,
        )


def load_task(path: Path, cache: Cache | None = None) -> Task:
    """Load the task of a document. Raises :class:`SpecError` with every finding, including those of its scene.

    ``cache`` stores convex decompositions between runs.
    """
    loaded = load_kind(path, "task/1")
    spec = loaded.spec
    assert isinstance(spec, TaskSpec)
    scene = loaded.used(spec.scene)
    if scene is None:
        raise SpecError([loaded.finding("SF005", ("scene",), f"`{spec.scene}` is not a readable scene")])
    setup = TaskSetup(loaded, scene, cache=cache)
    return Task(
        name=spec.name,
        scene=lowered(setup),
        instruction=spec.instruction,
        robots=spec.robots or tuple(setup.scene_spec.robots),
        goal=spec.goal,
        subtasks=MappingProxyType(_subtasks(spec)),
        reset=spec.reset,
        carriers=carried_by(setup),
        control_hz=spec.control_hz,
        horizon=spec.horizon,
        setup=setup,
    )


def need_robots(task: Task) -> None:
    """Raise :class:`SimfoundryError` if a robot that should act is missing, or its model cannot be controlled."""
    if not task.robots:
        raise SimfoundryError(f"task `{task.name}` has no robot to act: its scene has none")
    for name, reason in task.missing_robots.items():
        raise SimfoundryError(f"task `{task.name}` needs robot `{name}`, which is left out: {reason}")
    for name in task.robots:
        check_can_act(task.scene.robot(name))


def _subtasks(spec: TaskSpec) -> dict[str, SubtaskGoal]:
    return {
        name: SubtaskGoal(name, step.goal, step.instruction or spec.instruction, step.start is not None)
        for name, step in spec.subtasks.items()
    }
