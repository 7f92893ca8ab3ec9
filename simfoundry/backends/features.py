"""The features of a scene and their losses: the rows of the support matrix and of the loss report.

Each backend has a table, :data:`Cells`, with the fidelity of each feature. A compile reports its losses as typed
records, from which ``loss.json`` and every report are generated; they agree with the table.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import NamedTuple
from weakref import WeakKeyDictionary

import yaml

from simfoundry.geometry.shapes import Box, Capsule, Cylinder, Mesh, Sphere
from simfoundry.scene.meshfile import has_texture
from simfoundry.scene.model import Collider, Joint, JointType, LightType, Scene, SceneObject

Users = Callable[[Scene], Iterable[str]]
"""The elements of a scene that use a feature, by name; a joint as ``object.joint``."""

_KEPT = "kept"
"""The entry for a feature that a target preserves exactly."""

_OF_ROBOTS = ("robots", "robot_motors", "robot_contacts")
"""The features that are lost together with a robot if the robot is dropped."""


class Fidelity(StrEnum):
    """The ways in which a target fails to keep a feature exactly; a scene with a rejected one is not compiled."""

    APPROXIMATED = "approximated"
    DROPPED = "dropped"
    REJECTED = "rejected"


@dataclass(frozen=True)
class SupportCell:
    """The fidelity of a feature in a target: exact if ``fidelity`` is None; ``reason`` explains any other."""

    fidelity: Fidelity | None = None
    reason: str = ""


Cells = Mapping[str, SupportCell]


@dataclass(frozen=True)
class Feature:
    """One property that a spec can state: its group, a label for people, and the elements that use it in a scene.

    ``quantity`` is the last word of the path of a loss, as in ``cup.friction``; empty if the element alone is the path.
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


def read_cells(folder: Path) -> dict[str, SupportCell]:
    """Read the ``features.yaml`` of a backend: exact features, with or without a remark, and reasons for the others."""
    text = (folder / "features.yaml").read_text(encoding="utf-8")
    table = yaml.load(text, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader))
    cells = exact(*table["exact"]) | {name: SupportCell(None, remark) for name, remark in table["remarks"].items()}
    cells |= {name: approximated(reason) for name, reason in table["approximated"].items()}
    return cells | {name: dropped(reason) for name, reason in table["dropped"].items()}


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
    return [item.name for item in scene.objects if item.no_contact] + ["no_contact"] * bool(scene.no_contact)


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


class Size(NamedTuple):
    """The size of an approximation: a value and its unit, where ``1`` means a ratio or a coefficient."""

    value: float
    unit: str


@dataclass(frozen=True)
class Loss:
    """A feature of the scene that a target cannot keep exactly.

    ``feature`` is a key of :data:`FEATURES`. ``element`` is the name in the scene of the object, joint, collider or
    light that is affected, or empty if all users of the feature are. ``size`` is the error of an approximation, None if
    it is unknown.
    """

    feature: str
    element: str
    fidelity: Fidelity
    reason: str
    size: Size | None = None

    @property
    def path(self) -> str:
        """The element and its quantity, such as ``cup.friction``, or only the quantity if all elements are affected."""
        words = dict.fromkeys((self.element, FEATURES[self.feature].quantity))
        return ".".join(filter(None, words)) or self.feature


def approximate(feature: str, element: str, reason: str, value: float | None = None, unit: str = "1") -> Loss:
    """Return the loss of a feature that is approximated with an error of ``value`` in ``unit``."""
    size = None if value is None else Size(float(f"{value:.3g}"), unit)
    return Loss(feature, element, Fidelity.APPROXIMATED, reason, size)


def drop(feature: str, element: str, reason: str) -> Loss:
    """Return the loss of a feature that is left out."""
    return Loss(feature, element, Fidelity.DROPPED, reason)


def combination_reason(simulator: str, rule: str, a: float, b: float, got: float, wanted: float) -> str:
    """Return the reason of a loss if a simulator combines two coefficients by another rule than the scene."""
    return f"{simulator} takes {rule} of a pair: {got:.3g} for {a:.3g} and {b:.3g}; the scene specifies {wanted:.3g}."


def shared_losses(scene: Scene) -> Iterator[Loss]:
    """Yield the losses that lowering causes in every target, such as omitted parts and simplified colliders."""
    for part in scene.left_out:
        yield drop("robots" if part.path.startswith("robots.") else "mounted_cameras", part.path, part.reason)
    for item in scene.objects:
        error = max((link.collision_error for link in item.links), default=0.0)
        if error:
            count = sum(len(link.colliders) for link in item.links)
            subject = f"Its {count} colliders are" if count > 1 else "Its collider is"
            reason = f"{subject} up to {1000 * error:.2g} mm away from the visual surface."
            yield approximate("collision_shape", item.name, reason, 1000 * error, "mm")


def variant_losses(scene: Scene, target: str) -> Iterator[Loss]:
    """Yield one loss per object with variants, for a target whose files hold only one variant."""
    for item in scene.objects:
        if item.variants:
            others = ", ".join(f"`{v.variant}`" for v in item.variants)
            reason = f"{target} holds one variant: `{item.variant}` is written; {others} are left out."
            yield drop("variants", item.name, reason)


def splat_losses(scene: Scene, target: str) -> Iterator[Loss]:
    """Yield the loss of a Gaussian splat in a target that draws only surfaces."""
    if scene.background is not None and scene.background.splat is not None:
        yield drop("background_splat", "background", f"{target} renders surfaces, and a Gaussian splat has none.")


def count_fates(scene: Scene, losses: Iterable[Loss]) -> dict[str, dict[str, int]]:
    """Count the elements that keep each used feature, have it approximated, or lose it; zeros are omitted.

    If an element has several losses, the worst one counts.
    """
    users = _users(scene)
    worst: dict[str, dict[str, Fidelity]] = {name: {} for name in users}
    for loss in losses:
        whole_robot = loss.feature == "robots" and loss.fidelity is Fidelity.DROPPED
        for name in _OF_ROBOTS if whole_robot else (loss.feature,):
            for user in _elements(users[name], loss.element):
                if worst[name].get(user, Fidelity.APPROXIMATED) is Fidelity.APPROXIMATED:
                    worst[name][user] = loss.fidelity
    counts = {name: Counter(worst[name].get(each, _KEPT) for each in elements) for name, elements in users.items()}
    return {name: {f: found[f] for f in (_KEPT, *Fidelity) if f in found} for name, found in counts.items() if found}


def _users(scene: Scene) -> Mapping[str, list[str]]:
    """Return the elements that use each feature of a scene; cached because every target needs them."""
    if scene not in _USERS:
        _USERS[scene] = {name: list(feature.users(scene)) for name, feature in FEATURES.items()}
    return _USERS[scene]


_USERS: WeakKeyDictionary[Scene, Mapping[str, list[str]]] = WeakKeyDictionary()


def _elements(users: list[str], element: str) -> list[str]:
    """Return the elements that a loss affects: the element or its owner if one is named, otherwise all users."""
    if not element or element in users:
        return [element] if element else users
    return [user for user in users if element.startswith(f"{user}.")]
