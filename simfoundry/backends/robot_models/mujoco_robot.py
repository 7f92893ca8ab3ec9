"""Robots that MuJoCo reads from MJCF or URDF, with meshes named by a hash of their content.

MuJoCo is the only available reader for both formats. If a robot has no model in the target's own format, the model read
by MuJoCo is converted.
"""

from __future__ import annotations

import hashlib
import math
import re
import warnings
from collections.abc import Iterable, Iterator, Mapping, Set
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from simfoundry.errors import SimfoundryError
from simfoundry.scene.robot import FILES_ONLY, NativeModel, Robot
from simfoundry.scene.robot_files import urdf_mesh, urdf_meshes

if TYPE_CHECKING:
    import mujoco

# Position error [rad or m] at which a servo that was added to an unactuated joint reaches its maximum force.
_SERVO_ERROR = 0.005

# Maximum force of an added servo [N m or N] if the model does not limit it.
_EFFORT = 100.0

_OURS = '<mujoco><compiler fusestatic="false" discardvisual="false" strippath="false" meshdir=""/></mujoco>'


class RobotModelError(SimfoundryError):
    """Raised if a robot model cannot be used. The message names the robot and the problem."""

    @classmethod
    def missing(cls, where: str, kind: str, name: str, known: Iterable[str]) -> RobotModelError:
        """Return the error for an unknown joint or link, listing the available names."""
        return cls(f"{where} has no {kind} `{name}`; available {kind}s: {', '.join(known)}")


@dataclass(frozen=True, eq=False)
class MujocoRobot:
    """A robot model loaded in MuJoCo.

    Attributes:
        native: The model that was read.
        prefix: The prefix of all names in ``spec``.
        spec: The specification of the robot.
        model: The compiled specification.
        files: The meshes and textures, keyed by file name.
        qpos: The initial positions, shape (nq,).
        ctrl: The initial controls, shape (nu,).
        servos: The names of the actuators that were added.
    """

    native: NativeModel
    prefix: str
    spec: mujoco.MjSpec
    model: mujoco.MjModel
    files: Mapping[str, bytes]
    qpos: np.ndarray
    ctrl: np.ndarray
    servos: tuple[str, ...]


@lru_cache(maxsize=4)  # all targets read the same robot, and robots are compared by identity
def read_robot(robot: Robot, native: NativeModel, prefix: str) -> MujocoRobot:
    """Read a robot's MJCF or URDF with its base at the origin.

    Raises:
        RobotModelError: If MuJoCo cannot read the model.
    """

    files: dict[str, bytes] = {}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # intended: the scene's options override the robot's
            spec, home = _assemble(native, prefix, files)
            spec.assets = files
            model = spec.compile()
            servos = tuple(_add_servos(spec, model, {prefix + name: force for name, force in native.effort.items()}))
            grip = native.gripper.joints if native.gripper is not None and not servos else {}
            strong = {prefix + name: force for name, force in native.effort.items() if name in grip}
            if strong:
                _set_grip(spec, model, strong)
            model = spec.compile() if servos or strong else model
            if robot.has_own_gains:
                _scale_gains(spec, model, robot, {prefix + name for name in native.joints.values()})
                model = spec.compile()
            _explicit_masses(spec, model)
    except (ValueError, OSError, KeyError) as error:
        reason = str(error).strip().splitlines()[0]
        raise RobotModelError(f"robot `{robot.name}`: MuJoCo could not read {native.file}: {reason}") from error
    qpos = _start(robot, native, prefix, model, home[0] if len(home[0]) == model.nq else model.qpos0)
    ctrl = _controls(native, prefix, model, qpos, home[1] if len(home[1]) == model.nu else np.zeros(model.nu))
    return MujocoRobot(native, prefix, spec, model, files, qpos, ctrl, servos)


def _assemble(
    native: NativeModel, prefix: str, files: dict[str, bytes]
) -> tuple[mujoco.MjSpec, tuple[np.ndarray, np.ndarray]]:
    """Return a single spec in which the model and its attached models are combined at the world origin.

    Also returns the positions and controls in the ``home`` keyframe, which are empty if there is no such keyframe.
    """
    import mujoco

    whole = _read(native.file, files)
    key = next((key for key in whole.keys if key.name == "home"), None)
    home = (np.array(key.qpos), np.array(key.ctrl)) if key is not None else (np.zeros(0), np.zeros(0))
    for part in native.attached:
        carrier = whole.body(part.to)
        if carrier is None:
            raise ValueError(f"the model has no body `{part.to}` to which {part.file.name} can be attached")
        child = _read(part.file, files)
        _same_options(whole, child)
        frame = carrier.add_frame(pos=part.X_LB.p, quat=part.X_LB.q)
        whole.attach(child, prefix=f"{part.name}.", frame=frame)
    parent = mujoco.MjSpec()
    _same_options(whole, parent)
    parent.attach(whole, prefix=prefix, frame=parent.worldbody.add_frame())
    for key in list(parent.keys):
        parent.delete(key)
    return parent, home


def _same_options(source: mujoco.MjSpec, target: mujoco.MjSpec) -> None:
    """Copy the options of ``source`` to ``target``. Otherwise, MuJoCo would print a warning when it attaches models."""
    for name in dir(source.option):
        if not name.startswith("_"):
            setattr(target.option, name, getattr(source.option, name))


def _read(file: Path, files: dict[str, bytes]) -> mujoco.MjSpec:
    """Read a model, name its meshes and textures after their content, and add them to ``files``."""
    import mujoco

    if file.suffix.lower() == ".urdf":
        spec = mujoco.MjSpec.from_string(_portable_urdf(file, files))
    else:
        spec = mujoco.MjSpec.from_file(str(file))
        folder = Path(spec.modelfiledir)
        for item, directory in [(m, spec.meshdir) for m in spec.meshes] + [(t, spec.texturedir) for t in spec.textures]:
            if item.file:
                item.file = _keep(folder / directory / item.file, files)
        spec.meshdir = spec.texturedir = spec.modelfiledir = ""
    for kind, items in (("body", spec.bodies[1:]), ("joint", spec.joints)):
        for k, item in enumerate(items):
            item.name = item.name or f"{kind}{k}"
    for light in list(spec.lights):  # the lights in the file are not part of the robot
        spec.delete(light)
    return spec


def _keep(path: Path, files: dict[str, bytes]) -> str:
    data = path.read_bytes()
    name = f"{hashlib.sha256(data).hexdigest()[:16]}{path.suffix.lower()}"
    files[name] = data
    return name


def _portable_urdf(file: Path, files: dict[str, bytes]) -> str:
    """Return the text of a URDF whose meshes are named after their content.

    COLLADA meshes are omitted, because MuJoCo cannot read them.
    """
    text = file.read_text(encoding="utf-8")
    for name in urdf_meshes(text):
        path = urdf_mesh(file, name)
        if path.suffix.lower() in (".stl", ".obj", ".msh"):
            text = text.replace(f'"{name}"', f'"{_keep(path, files)}"').replace(f"'{name}'", f'"{_keep(path, files)}"')
    text = re.sub(r"<(visual|collision)\b(?:(?!</\1>).)*\.dae(?:(?!</\1>).)*</\1>", "", text, flags=re.DOTALL)
    text = re.sub(r"<mujoco\b.*?</mujoco>", "", text, flags=re.DOTALL)
    text = re.sub(r"<\?xml[^>]*\?>", "", text, count=1)
    return re.sub(r"(<robot\b[^>]*>)", lambda found: found[1] + _OURS, text, count=1)


def _explicit_masses(spec: mujoco.MjSpec, model: mujoco.MjModel) -> None:
    """Set each body's mass and inertia explicitly, because the scene's options prevent deriving them from geoms."""
    for body in spec.bodies[1:]:
        k = model.body(body.name).id
        if model.body_mass[k] > 0:
            body.mass, body.ipos, body.iquat = float(model.body_mass[k]), model.body_ipos[k], model.body_iquat[k]
            body.inertia = model.body_inertia[k]
            body.fullinertia = [math.nan] * 6
            body.explicitinertial = True


def _add_servos(spec: mujoco.MjSpec, model: mujoco.MjModel, effort: Mapping[str, float]) -> Iterator[str]:
    """Add a position servo to every joint of a model without actuators, and yield their names."""
    import mujoco

    if model.nu > 0:
        return
    moving = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
    followers = {int(model.eq_obj1id[k]) for k in range(model.neq) if model.eq_type[k] == int(mujoco.mjtEq.mjEQ_JOINT)}
    for joint in spec.joints:
        k = model.joint(joint.name).id
        if k in followers or int(model.jnt_type[k]) not in moving:
            continue
        stated = float(model.jnt_actfrcrange[k][1]) if model.jnt_actfrclimited[k] else _EFFORT
        limit = effort.get(joint.name, stated)
        joint.actfrcrange = [-limit, limit]
        servo = spec.add_actuator(name=joint.name, target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        servo.set_to_position(kp=limit / _SERVO_ERROR, dampratio=1.0)
        servo.forcerange = [-limit, limit]
        yield joint.name


def _set_grip(spec: mujoco.MjSpec, model: mujoco.MjModel, effort: Mapping[str, float]) -> None:
    """Give the position servos of a gripper's joints the stated forces, which the model may not reach."""
    import mujoco

    on_joint = int(mujoco.mjtTrn.mjTRN_JOINT)
    for k, actuator in enumerate(spec.actuators):
        joint = model.joint(int(model.actuator_trnid[k][0])).name
        if int(model.actuator_trntype[k]) == on_joint and joint in effort:
            actuator.set_to_position(kp=effort[joint] / _SERVO_ERROR, dampratio=1.0)
            actuator.forcerange = [-effort[joint], effort[joint]]


def _scale_gains(spec: mujoco.MjSpec, model: mujoco.MjModel, robot: Robot, arm: Set[str]) -> None:
    """Scale the servos and the damping of the joints in ``arm``, or of all joints if it is empty.

    The compiled values are scaled, because the specification may state a damping ratio instead of a damping.
    """
    import mujoco

    on_joint = int(mujoco.mjtTrn.mjTRN_JOINT)
    for k, actuator in enumerate(spec.actuators):
        joint = model.joint(int(model.actuator_trnid[k][0])).name
        if int(model.actuator_trntype[k]) == on_joint and (not arm or joint in arm):
            gain, bias = model.actuator_gainprm[k].copy(), model.actuator_biasprm[k].copy()
            gain[0] *= robot.stiffness
            bias[:3] *= (robot.stiffness, robot.stiffness, robot.damping)
            actuator.gainprm, actuator.biasprm = gain, bias
    for joint in spec.joints:
        if not arm or joint.name in arm:
            joint.damping = joint.damping * robot.damping


def _start(robot: Robot, native: NativeModel, prefix: str, model: mujoco.MjModel, home: np.ndarray) -> np.ndarray:
    """Return the initial positions specified by the scene and the gripper, or otherwise by the ``home`` keyframe."""
    import mujoco

    qpos = np.array(home)
    positions = robot.start(native)
    follow = native.gripper.follow if native.gripper is not None else {}
    for name, leader in follow.items():
        if leader.joint in positions:
            positions.setdefault(name, leader.multiplier * positions[leader.joint] + leader.offset)
    for name, position in positions.items():
        joint = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, prefix + name)
        if joint < 0:
            known = (model.joint(k).name.removeprefix(prefix) for k in range(model.njnt))
            raise RobotModelError.missing(f"robot `{robot.name}`: {native.file.name}", "joint", name, known)
        qpos[model.jnt_qposadr[joint]] = position
    return qpos


def _controls(
    native: NativeModel, prefix: str, model: mujoco.MjModel, qpos: np.ndarray, home: np.ndarray
) -> np.ndarray:
    """Return the controls that hold the initial state.

    Servo targets are the joint positions, and grippers are open.
    """
    import mujoco

    command = native.gripper.command if native.gripper is not None else {}
    ctrl = np.array(home)
    for k in range(model.nu):
        name = model.actuator(k).name.removeprefix(prefix)
        gain, spring = float(model.actuator_gainprm[k][0]), float(model.actuator_biasprm[k][1])
        if name in command:
            ctrl[k] = command[name][0]
        elif model.actuator_trntype[k] == int(mujoco.mjtTrn.mjTRN_JOINT) and gain and spring < 0:
            ctrl[k] = qpos[model.jnt_qposadr[model.actuator_trnid[k][0]]] * -spring / gain
        if model.actuator_ctrllimited[k]:
            ctrl[k] = np.clip(ctrl[k], *model.actuator_ctrlrange[k])
    return ctrl


def xml(read: MujocoRobot) -> str:
    """Return the robot's MJCF, in which every name starts with its prefix."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # otherwise the warnings about meshes are repeated
        return str(read.spec.to_xml())


def body_name(read: MujocoRobot, frame: str) -> str:
    """Return the prefixed name of the body that a robot frame belongs to.

    Raises:
        RobotModelError: If the body is missing.
    """
    link = read.native.frame(frame).link if frame else root_name(read).removeprefix(read.prefix)
    name = read.prefix + link
    bodies = [body.name for body in read.spec.bodies]
    if name not in bodies:
        known = (body.removeprefix(read.prefix) for body in bodies[1:])
        raise RobotModelError.missing(read.native.file.name, "link", link, known)
    return name


def root_name(read: MujocoRobot) -> str:
    """Return the prefixed name of the robot's first body."""
    return str(read.spec.bodies[1].name)


def document_fields(robot: Robot) -> dict[str, object] | None:
    """Return the fields of a robot in a scene document, except for its pose, or None if the robot has no description.

    The fields are written alongside the robot model so that an import restores a robot instead of an articulated
    object.
    """
    if robot.kind == FILES_ONLY:
        return None
    sizes = {"reach": robot.reach, "opening": robot.opening}
    fields: dict[str, object] = {"model": robot.kind, "joints": dict(robot.positions)}
    fields |= {"gains": {"stiffness": robot.stiffness, "damping": robot.damping}} if robot.has_own_gains else {}
    return fields | {name: value for name, value in sizes.items() if value is not None}
