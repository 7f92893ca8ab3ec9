"""A task prepared for rollouts: its scene as the task starts, its steps as tasks of their own, its robots.

The `start` of a task, and then that of a step, are applied to the scene's document.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any

from simfoundry.assets.cache import Cache
from simfoundry.backends.robot_models.mujoco_robot import MujocoRobot, RobotModelError, body_name, read_robot
from simfoundry.errors import SimfoundryError
from simfoundry.scene.lower import lower
from simfoundry.scene.model import Scene
from simfoundry.scene.robot import Robot, mujoco_model
from simfoundry.spec.diagnostics import Diagnostic, SpecError, nearest
from simfoundry.spec.files import Loaded
from simfoundry.spec.load import load_kind
from simfoundry.spec.models.predicate import Condition, parse_call
from simfoundry.spec.models.scene import ObjectSpec, SceneSpec
from simfoundry.spec.models.task import Reset, Start, TaskSpec, with_starts


@dataclass(frozen=True, eq=False)
class TaskSetup:
    """The documents of a ``task`` and its ``scene``, and the ``step`` at which it starts, empty for the first."""

    task: Loaded
    scene: Loaded
    step: str = ""
    cache: Cache | None = None

    @property
    def task_spec(self) -> TaskSpec:
        """The task's document."""
        assert isinstance(self.task.spec, TaskSpec)
        return self.task.spec

    @property
    def scene_spec(self) -> SceneSpec:
        """The scene's document."""
        assert isinstance(self.scene.spec, SceneSpec)
        return self.scene.spec

    @property
    def starts(self) -> dict[tuple[str, ...], Start]:
        """Changes to the scene in order of application, by their paths in the task."""
        own = self.task_spec.subtasks[self.step].start if self.step else None
        return {("start",): self.task_spec.start} | ({("subtasks", self.step, "start"): own} if own else {})

    @property
    def put_by_step(self) -> frozenset[str]:
        """Names of the objects that the step's own start places."""
        own = self.starts.get(("subtasks", self.step, "start"))
        return frozenset((*own.place, *own.pose)) if own else frozenset()

    @cached_property
    def started(self) -> SceneSpec:
        """The scene's document with the starts applied; relations that they break are removed."""
        spec, starts = with_starts(self.scene_spec, self.starts.values()), self.starts.values()
        moved = {name for start in starts for name in (*start.place, *start.pose)}
        turned = {name for start in starts for name in start.joints}
        kept = [text for text in self.scene_spec.relations if not _is_undone(text, moved, turned)]
        carriers = {name: carrier for name in sorted(moved) if (carrier := _carrier(spec.objects[name]))}
        stood = [f"OnTop({name}, {carrier})" for name, carrier in carriers.items()]
        return spec.model_copy(update={"relations": (*kept, *stood)})

    def lowered(self) -> Scene:
        """Lower the scene as the task starts; raises :class:`SpecError`, with places in the task if its start is at
        fault.
        """
        try:
            return lower(replace(self.scene, spec=self.started), self.cache)
        except SpecError as error:
            raise SpecError([self._placed_in_task(d) for d in error.diagnostics]) from None

    def carriers(self) -> dict[str, str]:
        """Supporting object of each object, if stated by the documents."""
        calls = [parse_call(text) for text in self.started.relations]
        found = {c.args[0]: c.args[1].partition(".")[0] for c in calls if c.predicate in ("OnTop", "Inside")}
        placed = {name: _carrier(item) for name, item in self.started.objects.items()}
        return found | {name: carrier for name, carrier in placed.items() if carrier}

    def _placed_in_task(self, finding: Diagnostic) -> Diagnostic:
        """Relocate a finding to the place in the task that placed the object, if there is one."""
        parts = finding.path.split(".")
        if finding.code == "SF210" and len(parts) == 3:
            for path, start in reversed(self.starts.items()):
                if parts[1] in start.place:
                    return self.task.finding("SF210", (*path, "place", parts[1]), finding.message, finding.hint)
        return finding


def _carrier(item: ObjectSpec) -> str:
    if item.place is None:
        return ""
    return (item.place.on or item.place.inside or "").partition(".")[0]


def _is_undone(relation: str, moved: set[str], turned: set[str]) -> bool:
    """Return whether moving these objects, or their joints, may break a relation."""
    call = parse_call(relation)
    names = {argument.partition(".")[0] for argument in call.args}
    return bool(names & moved) or (call.predicate in ("Open", "Closed") and bool(names & turned))


_FORM = "docs/robots.md, *Models of your own*, has the form"


def check_can_act(robot: Robot) -> None:
    """Raise :class:`RobotModelError` if a robot's model lacks an identifiable hand or an actuator for one of its
    joints.

    Observations and actions are defined in terms of these, so there is no substitute.
    """
    native = mujoco_model(robot)
    if native is None:
        raise RobotModelError(
            f"robot `{robot.name}` has only a USD model; rollouts need its hand and joints from an "
            "MJCF or URDF, so add one"
        )
    read = read_robot(robot, native, f"{robot.name}.")
    try:
        body_name(read, "hand")
    except RobotModelError as error:
        raise RobotModelError(
            f"robot `{robot.name}` has no identifiable hand: {error}; name it in a robot file, such as "
            f"`links: {{hand: {{link: {_leaf(read)}}}}}`, and name that file in the scene, such as "
            f"`model: {{file: my_arm.yaml}}`; {_FORM}"
        ) from None
    driven = _driven(read)
    for joint in native.joints.values() or [_own(read, read.model.joint(k)) for k in range(read.model.njnt)]:
        if joint not in driven:
            raise RobotModelError(
                f"robot `{robot.name}` cannot be position-controlled: no position actuator of {native.file.name} "
                f"drives its joint `{joint}`; add one, or list the arm's joints under `joints` in a robot file; {_FORM}"
            )


def _leaf(read: MujocoRobot) -> str:
    """Return the link farthest along the robot, which is most often its hand."""
    depth = [0]
    for body in range(1, read.model.nbody):
        depth.append(depth[int(read.model.body_parentid[body])] + 1)
    deepest = max(range(read.model.nbody), key=lambda body: depth[body])
    return _own(read, read.model.body(deepest))


def _own(read: MujocoRobot, named: Any) -> str:
    """Return the robot's own name of a body or joint of its model."""
    return str(named.name.removeprefix(read.prefix))


def _driven(read: MujocoRobot) -> set[str]:
    """Return the joints driven by a position actuator, by the model's names."""
    import mujoco

    model, found = read.model, set()
    for k in range(model.nu):
        pulls = model.actuator_gainprm[k][0] != 0 and model.actuator_biasprm[k][1] < 0
        if pulls and model.actuator_trntype[k] == int(mujoco.mjtTrn.mjTRN_JOINT):
            found.add(_own(read, model.joint(int(model.actuator_trnid[k][0]))))
    return found


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
        setup = replace(self.setup, step=name)
        regions = {n: region for n, region in self.reset.objects.items() if n not in setup.put_by_step}
        return replace(
            self,
            scene=setup.lowered(),
            reset=self.reset.model_copy(update={"objects": regions}),
            carriers=setup.carriers(),
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
        scene=setup.lowered(),
        instruction=spec.instruction,
        robots=spec.robots or tuple(setup.scene_spec.robots),
        goal=spec.goal,
        subtasks=MappingProxyType(
            {
                name: SubtaskGoal(name, step.goal, step.instruction or spec.instruction, step.start is not None)
                for name, step in spec.subtasks.items()
            }
        ),
        reset=spec.reset,
        carriers=setup.carriers(),
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
