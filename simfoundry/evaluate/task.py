"""A task prepared for rollouts: its scene as the task starts, its steps as tasks of their own, its robots.

The `start` of a task, and then that of a step, are applied to the scene's document.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType

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

    def with_step(self, name: str) -> TaskSetup:
        """Return the same documents, starting at a step."""
        return replace(self, step=name)

    @property
    def put_by_step(self) -> frozenset[str]:
        """Names of the objects that the step's own start places."""
        start = self.task_spec.subtasks[self.step].start if self.step else None
        return frozenset((*start.place, *start.pose)) if start is not None else frozenset()

    def starts(self) -> Iterator[tuple[tuple[str, ...], Start]]:
        """Yield the changes to the scene in order of application, each with its path in the task."""
        yield ("start",), self.task_spec.start
        own = self.task_spec.subtasks[self.step].start if self.step else None
        if own is not None:
            yield ("subtasks", self.step, "start"), own


def lowered(setup: TaskSetup) -> Scene:
    """Lower the scene as the task starts; raises :class:`SpecError`, with places in the task if its start is at
    fault.
    """
    spec = started(setup)
    try:
        return lower(replace(setup.scene, spec=spec), setup.cache)
    except SpecError as error:
        raise SpecError([_placed_in_task(setup, d) for d in error.diagnostics]) from None


def started(setup: TaskSetup) -> SceneSpec:
    """Apply the starts to the scene's document; relations that they break are removed."""
    spec = with_starts(setup.scene_spec, (start for _, start in setup.starts()))
    moved, turned = set[str](), set[str]()
    for _, start in setup.starts():
        moved |= {*start.place, *start.pose}
        turned |= {*start.joints}
    objects = spec.objects
    kept = [text for text in setup.scene_spec.relations if not _is_undone(text, moved, turned)]
    stood = [f"OnTop({name}, {_carrier(objects[name])})" for name in sorted(moved) if _carrier(objects[name])]
    return spec.model_copy(update={"relations": (*kept, *stood)})


def carried_by(setup: TaskSetup) -> dict[str, str]:
    """Supporting object of each object, if stated by the documents."""
    spec = started(setup)
    found = {}
    for text in spec.relations:
        call = parse_call(text)
        if call.predicate in ("OnTop", "Inside"):
            found[call.args[0]] = call.args[1].partition(".")[0]
    return found | {name: carrier for name, item in spec.objects.items() if (carrier := _carrier(item))}


def _carrier(item: ObjectSpec) -> str:
    if item.place is None:
        return ""
    return (item.place.on or item.place.inside or "").partition(".")[0]


def _is_undone(relation: str, moved: set[str], turned: set[str]) -> bool:
    """Return whether moving these objects, or their joints, may break a relation."""
    call = parse_call(relation)
    names = {argument.partition(".")[0] for argument in call.args}
    return bool(names & moved) or (call.predicate in ("Open", "Closed") and bool(names & turned))


def _placed_in_task(setup: TaskSetup, finding: Diagnostic) -> Diagnostic:
    """Relocate a finding to the place in the task that placed the object, if there is one."""
    parts = finding.path.split(".")
    if finding.code != "SF210" or len(parts) != 3:
        return finding
    for path, start in reversed(list(setup.starts())):
        if parts[1] in start.place:
            return setup.task.finding("SF210", (*path, "place", parts[1]), finding.message, finding.hint)
    return finding


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
    for joint in native.joints.values() or _moving(read):
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
    return str(read.model.body(deepest).name.removeprefix(read.prefix))


def _moving(read: MujocoRobot) -> list[str]:
    return [read.model.joint(k).name.removeprefix(read.prefix) for k in range(read.model.njnt)]


def _driven(read: MujocoRobot) -> set[str]:
    """Return the joints driven by a position actuator, by the model's names."""
    import mujoco

    model, found = read.model, set()
    for k in range(model.nu):
        pulls = model.actuator_gainprm[k][0] != 0 and model.actuator_biasprm[k][1] < 0
        if pulls and model.actuator_trntype[k] == int(mujoco.mjtTrn.mjTRN_JOINT):
            found.add(model.joint(int(model.actuator_trnid[k][0])).name.removeprefix(read.prefix))
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
