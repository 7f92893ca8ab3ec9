"""What a scene can say, feature by feature, and who says it: the rows of the support matrix and of the loss report.

Each backend has a table of these, :data:`Cells`, that says what it keeps; what a compile reports is held against it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple
from weakref import WeakKeyDictionary

from simfoundry.backends.artifact import Fidelity, Loss
from simfoundry.geometry.shapes import Box, Capsule, Cylinder, Mesh, Sphere
from simfoundry.scene.meshfile import has_texture
from simfoundry.scene.model import Collider, Joint, JointType, LightType, Scene, SceneObject

Users = Callable[[Scene], Iterable[str]]
"""The things of a scene that use a feature, by name; a joint as ``object.joint``."""


@dataclass(frozen=True)
class Cell:
    """What a target makes of a feature: exactly kept where ``fidelity`` is None; ``reason`` says why not."""

    fidelity: Fidelity | None = None
    reason: str = ""


Cells = Mapping[str, Cell]


@dataclass(frozen=True)
class Feature:
    """One thing that a spec can say: its group, its words, and what uses it in a scene."""

    group: str
    words: str
    users: Users


def exact(*features: str) -> dict[str, Cell]:
    """Cells of features that are kept as they are."""
    return dict.fromkeys(features, Cell())


def approximated(reason: str) -> Cell:
    """A cell of a feature that is kept, but not exactly."""
    return Cell(Fidelity.APPROXIMATED, reason)


def dropped(reason: str) -> Cell:
    """A cell of a feature that is left out."""
    return Cell(Fidelity.DROPPED, reason)


SIMPLER = approximated("in each target alike; the loss report says by how much")
"""The cell of shapes that collide as convex parts or primitives near them, which lowering decides for every target."""


def collider_losses(scene: Scene) -> Iterator[Loss]:
    """A loss for each object whose colliders are not the shapes that they stand for, with the greatest distance."""
    for item in scene.objects:
        error = max((link.collision_error for link in item.links), default=0.0)
        if error:
            count = sum(len(link.colliders) for link in item.links)
            what = f"its {count} colliders are" if count > 1 else "its collider is"
            reason = f"{what} up to {1000 * error:.2g} mm off the surface that is seen"
            yield Loss(f"{item.name}.colliders", Fidelity.APPROXIMATED, reason, "collision_shape")


def _objects(test: Callable[[SceneObject], object]) -> Users:
    return lambda scene: [item.name for item in scene.objects if test(item)]


def _colliders(test: Callable[[Collider], object]) -> Users:
    return _objects(lambda item: any(test(c) for link in item.links for c in link.colliders))


def _joints(test: Callable[[Joint], object]) -> Users:
    return lambda scene: [f"{item.name}.{j.name}" for item in scene.objects for j in item.joints if test(j)]


def _moving(joint: Joint) -> bool:
    return joint.type is not JointType.FIXED


def _lights(kind: LightType) -> Users:
    return lambda scene: [light.name for light in scene.lights if light.type is kind]


def _textured(item: SceneObject) -> bool:
    meshes = (v.geometry for link in item.links for v in link.visuals if isinstance(v.geometry, Mesh))
    return any(has_texture(mesh) for mesh in meshes)


def _silent(scene: Scene) -> list[str]:
    pairs = [item.name for item in scene.objects if item.no_contact]
    return [*pairs, *(["no_contact"] if scene.no_contact else [])]


def _left_out(scene: Scene, start: str) -> list[str]:
    return [part.path for part in scene.left_out if part.path.startswith(start)]


def _robots(scene: Scene) -> list[str]:
    """Those with a model; one without has no motors or surfaces that could be kept, either."""
    return [*(robot.name for robot in scene.robots), *_left_out(scene, "robots.")]


def _always(scene: Scene) -> list[str]:
    return [scene.name]


FEATURES: dict[str, Feature] = {
    "gravity": Feature("scene", "gravity", _always),
    "relations": Feature("scene", "stated relations", lambda s: [str(r) for r in s.relations]),
    "robots": Feature("scene", "robots: base, links, joints", _robots),
    "robot_motors": Feature("scene", "motors of robots", _robots),
    "robot_contacts": Feature("scene", "surfaces of robots", _robots),
    "mounted_cameras": Feature(
        "scene",
        "cameras on robots and objects",
        lambda s: [*(m.camera.name for m in s.mounted), *_left_out(s, "cameras.")],
    ),
    "cameras": Feature("scene", "cameras: pose and intrinsics", lambda s: [c.name for c in s.cameras]),
    "distant_lights": Feature("scene", "lights of parallel rays", _lights(LightType.DISTANT)),
    "point_lights": Feature("scene", "point lights", _lights(LightType.POINT)),
    "dome_lights": Feature("scene", "dome lights", _lights(LightType.DOME)),
    "background_mesh": Feature(
        "scene", "a mesh as background", lambda s: ["background"] * bool(s.background and s.background.visuals)
    ),
    "background_splat": Feature(
        "scene", "a Gaussian splat as background", lambda s: ["background"] * bool(s.background and s.background.splat)
    ),
    "pose": Feature("object", "pose in the world", _objects(lambda o: True)),
    "fixed": Feature("object", "welded to the world", _objects(lambda o: o.fixed)),
    "category": Feature("object", "category", _objects(lambda o: o.category)),
    "labels": Feature("object", "semantic labels", _objects(lambda o: o.labels)),
    "variants": Feature("object", "variants", _objects(lambda o: o.variants)),
    "visuals": Feature("object", "what is seen, with its colour", _objects(lambda o: any(k.visuals for k in o.links))),
    "texture": Feature("object", "textures", _objects(_textured)),
    "mass": Feature("body", "mass", _objects(lambda o: True)),
    "inertia": Feature("body", "centre of mass and inertia", _objects(lambda o: True)),
    "box": Feature("body", "boxes that collide", _colliders(lambda c: isinstance(c.geometry, Box))),
    "sphere": Feature("body", "spheres that collide", _colliders(lambda c: isinstance(c.geometry, Sphere))),
    "cylinder": Feature("body", "cylinders that collide", _colliders(lambda c: isinstance(c.geometry, Cylinder))),
    "capsule": Feature("body", "capsules that collide", _colliders(lambda c: isinstance(c.geometry, Capsule))),
    "convex_mesh": Feature("body", "convex parts that collide", _colliders(lambda c: isinstance(c.geometry, Mesh))),
    "collision_shape": Feature(
        "body",
        "round and hollow shapes that collide as simpler ones",
        _objects(lambda item: any(link.collision_error for link in item.links)),
    ),
    "friction": Feature("body", "friction of a pair (geometric mean)", _colliders(lambda c: True)),
    "restitution": Feature("body", "restitution of a pair (geometric mean)", _colliders(lambda c: True)),
    "torsional_friction": Feature(
        "body", "resistance against spinning", _colliders(lambda c: c.torsional_friction > 0)
    ),
    "rolling_friction": Feature("body", "resistance against rolling", _colliders(lambda c: c.rolling_friction > 0)),
    "no_contact": Feature("body", "pairs that pass through each other", _silent),
    "fixed_joint": Feature("joint", "fixed joints", _joints(lambda j: j.type is JointType.FIXED)),
    "revolute": Feature("joint", "revolute joints", _joints(lambda j: j.type is JointType.REVOLUTE)),
    "continuous": Feature("joint", "continuous joints", _joints(lambda j: j.type is JointType.CONTINUOUS)),
    "prismatic": Feature("joint", "prismatic joints", _joints(lambda j: j.type is JointType.PRISMATIC)),
    "ball": Feature("joint", "ball joints", _joints(lambda j: j.type is JointType.BALL)),
    "free": Feature("joint", "free joints", _joints(lambda j: j.type is JointType.FREE)),
    "mimic": Feature("joint", "joints that follow others", _joints(lambda j: j.mimic is not None)),
    "drive": Feature("joint", "motors in joints", _joints(lambda j: j.drive is not None)),
    "joint_position": Feature("joint", "joint positions", _joints(_moving)),
    "joint_limits": Feature(
        "joint", "joint limits", _joints(lambda j: j.limits is not None or j.type is JointType.PRISMATIC)
    ),
    "joint_closed": Feature("joint", "the limit at which a joint is closed", _joints(lambda j: j.closed is not None)),
    "joint_damping": Feature("joint", "viscous damping of joints", _joints(lambda j: j.damping > 0)),
    "joint_friction": Feature("joint", "Coulomb friction of joints", _joints(lambda j: j.friction > 0)),
    "armature": Feature("joint", "armature", _joints(lambda j: j.armature > 0)),
}
"""Every feature by name, in the order in which reports show them."""

_OF_JOINT = {
    "limits": "joint_limits",
    "closed": "joint_closed",
    "damping": "joint_damping",
    "friction": "joint_friction",
    "armature": "armature",
    "position": "joint_position",
    "mimic": "mimic",
    "drive": "drive",
}
_OF_OBJECT = {"colliders": "convex_mesh"}
_OF_ROBOT = {"actuators": "robot_motors", "friction": "robot_contacts", "gripper": "robot_contacts"}
_OF_LIGHT = {
    LightType.DISTANT: "distant_lights",
    LightType.POINT: "point_lights",
    LightType.DOME: "dome_lights",
}


def feature_of(loss: Loss, scene: Scene) -> str:
    """The feature that a loss is about; empty where it is none of the known ones."""
    if loss.feature:
        return loss.feature
    if loss.path in FEATURES:
        return loss.path
    owner, *below = loss.path.split(".")
    if any(part.path == loss.path for part in scene.left_out):
        return {"robots": "robots", "cameras": "mounted_cameras"}.get(owner, "")
    if any(robot.name == owner for robot in scene.robots):
        return _OF_ROBOT.get(below[0] if below else "", "robots")
    if any(mounted.camera.name == owner for mounted in scene.mounted):
        return "mounted_cameras"
    word = below[-1] if below else ""
    item = scene.by_name.get(owner)
    if item is not None and word:
        joint = next((j for j in item.joints if j.name == below[0]), None)
        if joint is not None:
            return _OF_JOINT.get(below[1], "") if len(below) > 1 else _type_of(joint)
        return _OF_OBJECT.get(word, word if word in FEATURES else "")
    light = next((light for light in scene.lights if light.name == owner), None)
    if light is not None:
        return _OF_LIGHT[light.type]
    if any(mounted.camera.name == owner for mounted in scene.mounted):
        return "mounted_cameras"
    return "cameras" if any(camera.name == owner for camera in scene.cameras) else ""


def _type_of(joint: Joint) -> str:
    return "fixed_joint" if joint.type is JointType.FIXED else joint.type.value


def fates(scene: Scene, losses: Iterable[Loss]) -> dict[str, dict[str, int]]:
    """How many users of each feature in use are ``kept``, ``approximated`` and ``dropped``; what is 0 is left out.

    A loss whose path names no single user is meant of them all.
    """
    found: dict[str, dict[str, Fidelity]] = {}
    users = _users(scene)
    for loss in losses:
        for name in _concerned(loss, scene):
            worst = found.setdefault(name, {})
            for user in users[name].meant(loss) if name in users else ():
                if worst.get(user) is not Fidelity.DROPPED:
                    worst[user] = loss.fidelity
    return {name: dict(_count(using.all, found.get(name, {}))) for name, using in users.items() if using.all}


def _users(scene: Scene) -> dict[str, _Users]:
    """By feature who uses it in a scene; every target asks."""
    if scene not in _USERS:
        _USERS[scene] = {name: _Users.of(feature.users(scene)) for name, feature in FEATURES.items()}
    return _USERS[scene]


_USERS: WeakKeyDictionary[Scene, dict[str, _Users]] = WeakKeyDictionary()


def _concerned(loss: Loss, scene: Scene) -> tuple[str, ...]:
    """The features that a loss is about: with a robot go its motors and its surfaces."""
    name = feature_of(loss, scene)
    gone = name == "robots" and loss.fidelity is Fidelity.DROPPED
    return ("robots", "robot_motors", "robot_contacts") if gone else (name,)


class _Users(NamedTuple):
    """The users of a feature, and by owner those of each."""

    all: list[str]
    of_owner: dict[str, list[str]]

    @classmethod
    def of(cls, users: Iterable[str]) -> _Users:
        every = list(users)
        of_owner: dict[str, list[str]] = {}
        for user in every:
            of_owner.setdefault(user.partition(".")[0], []).append(user)
        return cls(every, of_owner)

    def meant(self, loss: Loss) -> list[str]:
        """Those that a loss is about: the nearest to its path, else all of its owner, else all."""
        path = loss.path
        near = self.of_owner.get(path.partition(".")[0], [])
        nearest = [u for u in near if path == u or path.startswith(f"{u}.") or u.startswith(f"{path}.")]
        return nearest or near or self.all


def _count(users: list[str], worst: Mapping[str, Fidelity]) -> Iterator[tuple[str, int]]:
    of = [worst[u].value if u in worst else "kept" for u in users]
    for fate in ("kept", *(f.value for f in Fidelity)):
        if fate in of:
            yield fate, of.count(fate)
