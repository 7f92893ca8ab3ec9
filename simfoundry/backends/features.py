"""The features of a scene: the rows of the support matrix and of the loss report.

Each backend has a table of these, :data:`Cells`, with the fidelity that it keeps; the losses that a compile reports are
held against it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum

from simfoundry.geometry.shapes import Box, Capsule, Cylinder, Mesh, Sphere
from simfoundry.scene.meshfile import has_texture
from simfoundry.scene.model import Collider, Joint, JointType, LightType, Scene, SceneObject

Users = Callable[[Scene], Iterable[str]]
"""The elements of a scene that use a feature, by name; a joint as ``object.joint``."""


class Fidelity(StrEnum):
    """The ways in which a target fails to keep a feature exactly; a scene with a rejected one is not compiled."""

    APPROXIMATED = "approximated"
    DROPPED = "dropped"
    REJECTED = "rejected"


@dataclass(frozen=True)
class SupportCell:
    """The fidelity of a feature in a target: exact where ``fidelity`` is None; ``reason`` explains any other."""

    fidelity: Fidelity | None = None
    reason: str = ""


Cells = Mapping[str, SupportCell]


@dataclass(frozen=True)
class Feature:
    """One thing that a spec can state: its group, a label for people, and the elements that use it in a scene.

    ``quantity`` is the last word of the path of a loss, as in ``cup.friction``; empty where the element says it all.
    """

    group: str
    label: str
    users: Users
    quantity: str = ""


def exact(*features: str) -> dict[str, SupportCell]:
    """Return the cells of features that are kept exactly."""
    return dict.fromkeys(features, SupportCell())


def approximated(reason: str) -> SupportCell:
    """Return the cell of a feature that is kept, but not exactly."""
    return SupportCell(Fidelity.APPROXIMATED, reason)


def dropped(reason: str) -> SupportCell:
    """Return the cell of a feature that is left out."""
    return SupportCell(Fidelity.DROPPED, reason)


def rejected(reason: str) -> SupportCell:
    """Return the cell of a feature whose scenes are not compiled."""
    return SupportCell(Fidelity.REJECTED, reason)


SIMPLIFIED_COLLIDERS = approximated("Every target gets the same simpler shapes; the loss report states the distance.")
"""The cell of shapes that collide as convex parts or nearby primitives, which lowering decides for every target."""


def _of_objects(label: str, test: Callable[[SceneObject], object], quantity: str, group: str = "object") -> Feature:
    return Feature(group, label, lambda scene: [item.name for item in scene.objects if test(item)], quantity)


def _of_colliders(label: str, test: Callable[[Collider], object], quantity: str = "colliders") -> Feature:
    return _of_objects(label, lambda item: any(test(c) for k in item.links for c in k.colliders), quantity, "body")


def _of_joints(label: str, test: Callable[[Joint], object], quantity: str = "") -> Feature:
    def users(scene: Scene) -> list[str]:
        return [f"{item.name}.{joint.name}" for item in scene.objects for joint in item.joints if test(joint)]

    return Feature("joint", label, users, quantity)


def _of_lights(label: str, kind: LightType) -> Feature:
    return Feature("scene", label, lambda scene: [light.name for light in scene.lights if light.type is kind])


def _is_textured(item: SceneObject) -> bool:
    meshes = (v.geometry for link in item.links for v in link.visuals if isinstance(v.geometry, Mesh))
    return any(has_texture(mesh) for mesh in meshes)


def _excluded(scene: Scene) -> list[str]:
    pairs = [item.name for item in scene.objects if item.no_contact]
    return [*pairs, *(["no_contact"] if scene.no_contact else [])]


def _left_out(scene: Scene, section: str) -> list[str]:
    return [part.path for part in scene.left_out if part.path.startswith(f"{section}.")]


def _robots(scene: Scene) -> list[str]:
    """Return all robots; one without a model has no motors or surfaces that could be kept, either."""
    return [*(robot.name for robot in scene.robots), *_left_out(scene, "robots")]


def _mounted_cameras(scene: Scene) -> list[str]:
    return [*(mounted.camera.name for mounted in scene.mounted), *_left_out(scene, "cameras")]


def _meshes_around(scene: Scene) -> list[str]:
    return ["background"] * bool(scene.background and scene.background.visuals)


def _splats(scene: Scene) -> list[str]:
    return ["background"] * bool(scene.background and scene.background.splat)


FEATURES: dict[str, Feature] = {
    "gravity": Feature("scene", "gravity", lambda s: [s.name]),
    "relations": Feature("scene", "stated relations", lambda s: [str(r) for r in s.relations]),
    "robots": Feature("scene", "robots: base, links, joints", _robots),
    "robot_motors": Feature("scene", "motors of robots", _robots, "actuators"),
    "robot_contacts": Feature("scene", "surfaces of robots", _robots, "friction"),
    "mounted_cameras": Feature("scene", "cameras on robots and objects", _mounted_cameras),
    "cameras": Feature("scene", "cameras: pose and intrinsics", lambda s: [c.name for c in s.cameras]),
    "distant_lights": _of_lights("distant lights", LightType.DISTANT),
    "point_lights": _of_lights("point lights", LightType.POINT),
    "dome_lights": _of_lights("dome lights", LightType.DOME),
    "background_mesh": Feature("scene", "a mesh as background", _meshes_around),
    "background_splat": Feature("scene", "a Gaussian splat as background", _splats),
    "pose": _of_objects("pose in the world", lambda o: True, "pose"),
    "fixed": _of_objects("welded to the world", lambda o: o.fixed, "fixed"),
    "category": _of_objects("category", lambda o: o.category, "category"),
    "labels": _of_objects("semantic labels", lambda o: o.labels, "labels"),
    "variants": _of_objects("variants", lambda o: o.variants, "variants"),
    "visuals": _of_objects("visual shapes and their color", lambda o: any(k.visuals for k in o.links), "visuals"),
    "texture": _of_objects("textures", _is_textured, "texture"),
    "mass": _of_objects("mass", lambda o: True, "mass", "body"),
    "inertia": _of_objects("center of mass and inertia", lambda o: True, "inertia", "body"),
    "box": _of_colliders("collision boxes", lambda c: isinstance(c.geometry, Box)),
    "sphere": _of_colliders("collision spheres", lambda c: isinstance(c.geometry, Sphere)),
    "cylinder": _of_colliders("collision cylinders", lambda c: isinstance(c.geometry, Cylinder)),
    "capsule": _of_colliders("collision capsules", lambda c: isinstance(c.geometry, Capsule)),
    "convex_mesh": _of_colliders("convex collision meshes", lambda c: isinstance(c.geometry, Mesh)),
    "collision_shape": _of_objects(
        "round and hollow shapes that collide as simpler ones",
        lambda item: any(link.collision_error for link in item.links),
        "colliders",
        "body",
    ),
    "friction": _of_colliders("friction of a pair (geometric mean)", lambda c: True, "friction"),
    "restitution": _of_colliders("restitution of a pair (geometric mean)", lambda c: True, "restitution"),
    "torsional_friction": _of_colliders("torsional friction", lambda c: c.torsional_friction > 0, "torsional_friction"),
    "rolling_friction": _of_colliders("rolling friction", lambda c: c.rolling_friction > 0, "rolling_friction"),
    "no_contact": Feature("body", "excluded pairs", _excluded, "no_contact"),
    "fixed_joint": _of_joints("fixed joints", lambda j: j.type is JointType.FIXED),
    "revolute": _of_joints("revolute joints", lambda j: j.type is JointType.REVOLUTE),
    "continuous": _of_joints("continuous joints", lambda j: j.type is JointType.CONTINUOUS),
    "prismatic": _of_joints("prismatic joints", lambda j: j.type is JointType.PRISMATIC),
    "ball": _of_joints("ball joints", lambda j: j.type is JointType.BALL),
    "free": _of_joints("free joints", lambda j: j.type is JointType.FREE),
    "mimic": _of_joints("mimic joints", lambda j: j.mimic is not None, "mimic"),
    "drive": _of_joints("joint drives", lambda j: j.drive is not None, "drive"),
    "joint_position": _of_joints("joint positions", lambda j: j.type is not JointType.FIXED, "position"),
    "joint_limits": _of_joints(
        "joint limits", lambda j: j.limits is not None or j.type is JointType.PRISMATIC, "limits"
    ),
    "joint_closed": _of_joints("the limit at which a joint is closed", lambda j: j.closed is not None, "closed"),
    "joint_damping": _of_joints("viscous damping of joints", lambda j: j.damping > 0, "damping"),
    "joint_friction": _of_joints("Coulomb friction of joints", lambda j: j.friction > 0, "friction"),
    "armature": _of_joints("armature", lambda j: j.armature > 0, "armature"),
}
"""Every feature by name, in the order in which reports show them."""
