"""Lints SF201, SF214 and SF440: robot models that cannot be used, and joints and links that they do not have.

Only models of the document's own project are read, because those of known robots are tested. Those are read only if the
document sets their joints. Nothing is downloaded, and a model that is not available is not a fault of the document.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from simfoundry.backends.robot_models.mujoco_robot import MujocoRobot, RobotModelError
from simfoundry.errors import SimfoundryError
from simfoundry.lint.conditions import goals
from simfoundry.lint.lints import Lint, Path_, Subject, warning
from simfoundry.lint.robots import acting_robots
from simfoundry.scene.robot import ModelFormat, Robot, lower_robot, mujoco_model
from simfoundry.scene.robot_files import NoModelError
from simfoundry.spec.diagnostics import Diagnostic, nearest
from simfoundry.spec.files import packaged_model
from simfoundry.spec.models.predicate import Call, parse_call, texts
from simfoundry.spec.models.robot import RobotFiles, RobotSpec

HINT = "correct the model or the robot file; docs/robots.md describes the format"


@dataclass(frozen=True, eq=False)
class _Model:
    """A robot at home, and its model as MuJoCo reads it, or None if it has only a USD model."""

    robot: Robot
    read: MujocoRobot | None

    @property
    def joints(self) -> dict[str, tuple[float, float] | None]:
        """The limits [rad or m] of each joint, by its names in the model and in the scene. None means no limits."""
        if self.read is None:
            return {}
        model, prefix = self.read.model, self.read.prefix
        found: dict[str, tuple[float, float] | None] = {}
        for k in range(model.njnt):
            low, high = map(float, model.jnt_range[k])
            found[model.joint(k).name.removeprefix(prefix)] = (low, high) if model.jnt_limited[k] else None
        return found | {name: found[own] for name, own in self.read.native.joints.items() if own in found}

    @property
    def bodies(self) -> list[str]:
        """The names of the links in the model."""
        return [] if self.read is None else [b.name.removeprefix(self.read.prefix) for b in self.read.spec.bodies[1:]]

    @property
    def links(self) -> list[str]:
        """The names of the links in the model, and of the frames that scenes can refer to."""
        return [] if self.read is None else [*dict.fromkeys((*self.read.native.links, *self.bodies))]


def _model(subject: Subject, name: str, spec: RobotSpec) -> _Model:
    """Read the model of a robot at its home position.

    Raises:
        NoModelError: If no model of the robot is available.
        RobotModelError: If its model cannot be used.
    """
    from simfoundry.backends.robot_models.mujoco_robot import read_robot
    from simfoundry.backends.robot_models.robot_object import as_object

    scene = subject.loaded.used(subject.task.scene) if subject.is_task else subject.loaded
    assert scene is not None
    robot = lower_robot(name, spec.model_copy(update={"joints": "home"}), scene.path, fetch=False)
    native = mujoco_model(robot)
    if native is None:
        return _Model(robot, None)
    read = read_robot(robot, native, f"{name}.")
    as_object(robot, read)
    return _Model(robot, read)


def unusable_robots(subject: Subject) -> Iterator[Diagnostic]:
    """Find robots of the project whose models cannot be read, and cameras on links that they do not have."""
    from simfoundry.backends.usd.robots import open_model

    document = subject.loaded
    for name, spec in subject.scene.spec.robots.items():
        if not isinstance(spec.model, RobotFiles):
            continue
        path: Path_ = (
            "robots",
            name,
            "model",
            *(key for key in ("file", "mjcf", "urdf", "usd") if getattr(spec.model, key)),
        )
        try:
            model = _model(subject, name, spec)
            if ModelFormat.USD in model.robot.models:
                open_model(model.robot, model.robot.models[ModelFormat.USD])
        except NoModelError as error:
            if _is_local(spec.model):
                yield document.finding("SF214", path[:4], f"no model of `{name}` can be used: {error}", HINT)
            continue
        except RobotModelError as error:
            yield document.finding("SF214", path[:4], str(error), HINT)
            continue
        for frame, at in model.read.native.links.items() if model.read is not None else ():
            if at.link not in model.bodies:
                message = f"the frame `{frame}` of `{name}` is on the link `{at.link}`, which the model does not have"
                yield document.finding("SF214", path[:4], message, nearest(at.link, model.bodies))
        for camera, each in subject.scene.spec.cameras.items():
            carrier, _, link = (each.mount or "").partition(".")
            if carrier == name and link and model.links and link not in model.links:
                message = f"`{name}` has no link `{link}`"
                yield document.finding("SF201", ("cameras", camera, "mount"), message, nearest(link, model.links))


def _is_local(files: RobotFiles) -> bool:
    """Return True if none of the models is provided by a package that downloads robots."""
    named = [file for key in ("mjcf", "urdf", "usd") if (file := getattr(files, key)) is not None]
    return all(packaged_model(file) is None for file in named)


ROBOT_MODEL = Lint("SF214", ("scene/1",), unusable_robots)


def wrong_joints(subject: Subject) -> Iterator[Diagnostic]:
    """Find joint positions of robots that are outside the limits of the model, or of joints that it does not have."""
    for name, spec in subject.scene.spec.robots.items():
        if not isinstance(spec.joints, dict) or not spec.joints:
            continue
        try:
            joints = _model(subject, name, spec).joints
        except (NoModelError, SimfoundryError):  # reported above, or not available
            continue
        for joint, position in spec.joints.items():
            path = ("robots", name, "joints", joint)
            limits = joints.get(joint)
            if joints and joint not in joints:
                message = f"the model of `{name}` has no joint `{joint}`"
                yield subject.loaded.finding("SF201", path, message, nearest(joint, joints))
            elif limits is not None and not limits[0] - 1e-6 <= position <= limits[1] + 1e-6:
                message = f"`{joint}` of `{name}` at {position:g} is outside its limits, {limits[0]:g} to {limits[1]:g}"
                hint = "positions are in rad or m; the simulator pushes the joint back to its limit"
                yield warning(subject.loaded, "SF440", path, message, hint, (name, joint))


ROBOT_JOINTS = Lint("SF440", ("scene/1",), wrong_joints)


def cannot_act(subject: Subject) -> Iterator[Diagnostic]:
    """Find robots of the project that cannot act in rollouts, or that lack the gripper or link of a predicate."""
    from simfoundry.backends.robot_models.control import check_can_act

    known: dict[str, _Model] = {}
    arguments = {argument for call, _ in _calls(subject) for argument in call.args}
    for name, spec in subject.scene.spec.robots.items():
        own, named = spec.known(), {a.partition(".")[2] for a in arguments if a.startswith(f"{name}.")}
        if own is not None and named <= {*own.links}:  # its model is known to work
            continue
        try:
            known[name] = _model(subject, name, spec)
        except (NoModelError, SimfoundryError):  # reported in the scene
            continue
        if own is None and name in acting_robots(subject):
            try:
                check_can_act(known[name].robot)
            except RobotModelError as error:
                path: Path_ = ("robots", subject.task.robots.index(name)) if subject.task.robots else ("scene",)
                yield subject.loaded.finding("SF214", path, str(error))
    for call, path in _calls(subject):
        for argument, kind in zip(call.args, call.kinds, strict=True):
            owner, _, link = argument.partition(".")
            model = known.get(owner)
            if model is None or model.read is None:
                continue
            if kind == "robot" and model.read.native.gripper is None:
                message = f"`{owner}` has no gripper, so `{call.predicate}` cannot be evaluated"
                hint = "describe its gripper in a robot file; docs/robots.md describes the format"
                yield subject.loaded.finding("SF202", path, message, hint)
            elif link and link not in model.links:
                message = f"`{owner}` has no link `{link}`"
                yield subject.loaded.finding("SF201", path, message, nearest(link, model.links))


def _calls(subject: Subject) -> Iterator[tuple[Call, Path_]]:
    """Yield each predicate in the goals of a task, with its path."""
    for goal, path in goals(subject):
        for text, below in texts(goal):
            yield parse_call(text), (*path, *below)


ACTING_ROBOT = Lint("SF214", ("task/1",), cannot_act)
