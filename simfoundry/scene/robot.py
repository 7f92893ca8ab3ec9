"""Robots in the lowered scene, with their native models and the mapping from names in the scene to names in a model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from types import MappingProxyType
from weakref import WeakValueDictionary

from simfoundry.geometry.frames import IDENTITY, Pose
from simfoundry.scene.model import Mimic
from simfoundry.scene.robot_files import NoModelError, digest, find_model, model_files
from simfoundry.scene.state import pose
from simfoundry.spec.models import robot_file
from simfoundry.spec.models.robot import RobotSpec
from simfoundry.spec.models.robot_file import ModelSpec, RobotFileSpec


class ModelFormat(StrEnum):
    """The file format of a robot model."""

    MJCF = "mjcf"
    URDF = "urdf"
    USD = "usd"


@dataclass(frozen=True, eq=False)
class LinkFrame:
    """A frame that a scene can refer to, with the pose ``X_LF`` in a ``link`` of the model."""

    link: str
    X_LF: Pose = IDENTITY


@dataclass(frozen=True, eq=False)
class Gripper:
    """The joints of a gripper. Each pair of values is (open, closed).

    Attributes:
        command: The values of the model's actuators, or empty if the joints are driven directly.
        joints: The positions of the joints [rad or m]. The first joint indicates how far the gripper is closed.
        follow: The mimic joints that replace the model's closed loops and equality constraints in engines that do not
            support them.
    """

    command: Mapping[str, tuple[float, float]]
    joints: Mapping[str, tuple[float, float]]
    follow: Mapping[str, Mimic]

    def closed(self, position: float) -> float:
        """Return how far the gripper is closed, from 0 to 1, when the first joint is at ``position`` [rad or m]."""
        opened, closed = next(iter(self.joints.values()))
        return min(max((position - opened) / (closed - opened), 0.0), 1.0)

    def positions(self, share: float) -> dict[str, float]:
        """Return the positions [rad or m] of all joints when the gripper is closed by ``share``, from 0 to 1."""
        found = {name: start + share * (end - start) for name, (start, end) in self.joints.items()}
        for name, leader in self.follow.items():
            if leader.joint in found:
                found.setdefault(name, leader.position(found[leader.joint]))
        return found


@dataclass(frozen=True, eq=False)
class Attached:
    """A model that is mounted on a link of another model. All of its names are prefixed with ``name.``.

    ``X_LB`` is the mounted model's base pose in the frame of the ``to`` link.
    """

    name: str
    file: Path
    to: str
    X_LB: Pose


@dataclass(frozen=True, eq=False)
class NativeModel:
    """A robot model in one format.

    Attributes:
        file: The model file, which remains at its original location.
        digest: A hash of the content of all model files.
        joints: The names of the arm joints in the model, keyed by their names in the scene.
        effort: The maximum torque or force [N m or N] of joints whose actual limit is not specified in the file.
    """

    format: ModelFormat
    file: Path
    digest: str
    attached: tuple[Attached, ...]
    links: Mapping[str, LinkFrame]
    joints: Mapping[str, str]
    gripper: Gripper | None
    effort: Mapping[str, float]

    def frame(self, name: str) -> LinkFrame:
        """Return the frame that a scene calls ``name``, which is either a known frame or a link of the model."""
        return self.links.get(name) or LinkFrame(name)


# The kind of a robot that a document defines only by its files.
FILES_ONLY = "robot"


@dataclass(frozen=True, eq=False)
class Robot:
    """A robot whose base is welded to the world at ``X_WB``.

    Attributes:
        positions: The positions of the arm joints [rad or m], keyed by their names in the scene. The gripper is open.
        stiffness: The factor of the stiffness of the arm's servos, relative to the models.
        damping: The factor of the damping of the arm's servos and joints, relative to the models.
        reach: The horizontal reach [m], or None if unknown.
        opening: The gripper opening [m], or None if unknown.
        models: The available models, of which there is at least one.
    """

    name: str
    kind: str
    X_WB: Pose
    positions: Mapping[str, float]
    reach: float | None
    opening: float | None
    models: Mapping[ModelFormat, NativeModel]
    stiffness: float = 1.0
    damping: float = 1.0

    @property
    def has_own_gains(self) -> bool:
        """True if the gains of the servos differ from those in the models."""
        return (self.stiffness, self.damping) != (1.0, 1.0)

    def best(self, *formats: ModelFormat) -> NativeModel | None:
        """Return the robot's model in the first available format."""
        return next((self.models[f] for f in formats if f in self.models), None)

    def start(self, model: NativeModel) -> dict[str, float]:
        """Return the model's initial joint positions, with the arm as specified in the scene and the gripper open."""
        arm = {model.joints.get(name, name): position for name, position in self.positions.items()}
        opened = {n: pair[0] for n, pair in model.gripper.joints.items()} if model.gripper is not None else {}
        return opened | arm


def mujoco_model(robot: Robot) -> NativeModel | None:
    """Return the robot model that is best suited for MuJoCo, or None if MuJoCo cannot read any of the models."""
    return robot.best(ModelFormat.MJCF, ModelFormat.URDF)


_ROBOTS: WeakValueDictionary[tuple[object, ...], Robot] = WeakValueDictionary()
# Robots in use, keyed by content: the scenes in a batch share a robot and the data that backends have read from it.
_MODELS: WeakValueDictionary[tuple[object, ...], NativeModel] = WeakValueDictionary()

_SUFFIX = {ModelFormat.MJCF: ".xml", ModelFormat.URDF: ".urdf", ModelFormat.USD: ".usd"}


def lower_robot(name: str, spec: RobotSpec, document: Path, fetch: bool = True) -> Robot:
    """Lower the robot ``name`` in a scene document.

    Packages that download robots on first use do so only if ``fetch`` is set.

    Raises:
        NoModelError: If no model is available.
    """
    if isinstance(spec.model, str):
        robot_file.own_folder(must_exist=True)
        found = robot_file.known_robot_file(spec.model)
        if found is None:
            available = ", ".join(robot_file.robot_names())
            raise NoModelError(f"no robot is called `{spec.model}`; available robots: {available}")
        described, file = found
    elif spec.model.file is not None:
        file = find_model(spec.model.file, document, ".yaml", fetch)
        described = robot_file.read_robot_file(file)
    else:
        files = {"mjcf": spec.model.mjcf, "urdf": spec.model.urdf, "usd": spec.model.usd}
        stated = {key: ModelSpec(file=name) for key, name in files.items() if name is not None}
        described, file = RobotFileSpec.model_validate(stated), document
    models: dict[ModelFormat, NativeModel] = {}
    errors = []
    for form in ModelFormat:
        model: ModelSpec | None = getattr(described, form.value)
        try:
            models |= {} if model is None else {form: _model(form, model, file, fetch)}
        except NoModelError as error:
            errors.append(error)
    if not models:
        raise NoModelError(str(errors[0]) if errors else "")
    positions = described.home_positions | (spec.joints if isinstance(spec.joints, dict) else {})
    key = (name, spec.model_dump_json(), *(id(model) for model in models.values()))
    robot = _ROBOTS.get(key) or Robot(
        name=name,
        kind=spec.model if isinstance(spec.model, str) else FILES_ONLY,
        X_WB=pose(spec.pose),
        positions=MappingProxyType(positions),
        reach=spec.reach or described.reach,
        opening=spec.opening or described.opening,
        models=MappingProxyType(models),
        stiffness=spec.gains.stiffness,
        damping=spec.gains.damping,
    )
    return _ROBOTS.setdefault(key, robot)


def _model(key: ModelFormat, spec: ModelSpec, document: Path, fetch: bool) -> NativeModel:
    file = _first(spec.files, document, _SUFFIX[key], fetch)
    attached = []
    for name, part in spec.attach.items():
        references = [part.file] if isinstance(part.file, str) else part.file
        attached.append(Attached(name, _first(references, document, _SUFFIX[key], fetch), part.to, pose(part.pose)))
    files = [file, *(a.file for a in attached)]
    content = digest([path for one in files for path in model_files(one)])
    same = (key, content, *files, spec.model_dump_json())
    model = _MODELS.get(same) or NativeModel(
        format=key,
        file=file,
        digest=content,
        attached=tuple(attached),
        links=MappingProxyType({n: LinkFrame(f.link, pose(f.pose)) for n, f in spec.links.items()}),
        joints=MappingProxyType({f"joint{k}": joint for k, joint in enumerate(spec.joints, 1)}),
        gripper=_gripper(spec),
        effort=MappingProxyType(dict(spec.effort)),
    )
    return _MODELS.setdefault(same, model)


def _first(references: list[str], document: Path, suffix: str, fetch: bool) -> Path:
    """Return the first file that exists.

    Raises:
        NoModelError: If no file exists. The error is that of the first file whose package is installed.
    """
    reasons = []
    for reference in references:
        try:
            return find_model(reference, document, suffix, fetch)
        except NoModelError as error:
            reasons.append(error)
    raise next((reason for reason in reasons if reason.is_known), reasons[0])


def _gripper(spec: ModelSpec) -> Gripper | None:
    if spec.gripper is None:
        return None
    follow = {n: Mimic(f.joint, f.multiplier, f.offset) for n, f in spec.gripper.follow.items()}
    command, joints = (MappingProxyType(dict(values)) for values in (spec.gripper.command, spec.gripper.joints))
    return Gripper(command, joints, MappingProxyType(follow))
