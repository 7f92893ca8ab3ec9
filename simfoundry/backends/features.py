"""Scene features, which form the rows of the support matrix.

Each backend has a :data:`Cells` table that lists the fidelity of each feature. Its losses (`losses.py`) are consistent
with this table.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

import yaml

from simfoundry.geometry.shapes import Box, Capsule, Cone, Cylinder, Ellipsoid, Mesh, Sphere
from simfoundry.scene.attachments import Options
from simfoundry.scene.meshfile import has_texture
from simfoundry.scene.model import Collider, Joint, JointType, LightType, Scene, SceneObject

# A function that returns the names of the scene elements that use a feature; a joint is named ``object.joint``.
Users = Callable[[Scene], Iterable[str]]


class Fidelity(StrEnum):
    """A way in which a target fails to preserve a feature. Scenes that use a rejected feature are not compiled."""

    APPROXIMATED = "approximated"
    DROPPED = "dropped"
    REJECTED = "rejected"


@dataclass(frozen=True)
class SupportCell:
    """The fidelity of a feature in a target, which is None if the feature is exact, with a ``reason`` or a remark."""

    fidelity: Fidelity | None = None
    reason: str = ""


Cells = Mapping[str, SupportCell]


@dataclass(frozen=True)
class Feature:
    """A property that a spec can state.

    Attributes:
        group: The section of the support matrix that lists the feature.
        label: A human-readable name.
        users: A function that returns the names of the scene elements that use the feature.
        quantity: The last component of a loss path, such as ``friction`` in ``cup.friction``, or an empty string if the
            path consists only of the element name.
    """

    group: str
    label: str
    users: Users
    quantity: str = ""


def read_cells(folder: Path) -> dict[str, SupportCell]:
    """Read a backend's ``features.yaml``.

    The file lists the features that are exact, optional remarks, and a reason for each loss.
    """
    text = (folder / "features.yaml").read_text(encoding="utf-8")
    table = yaml.load(text, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader))
    cells = dict.fromkeys(table.pop("exact"), SupportCell())
    cells |= {name: SupportCell(None, remark) for name, remark in table.pop("remarks").items()}
    for fidelity, reasons in table.items():
        cells |= {name: SupportCell(Fidelity(fidelity), reason) for name, reason in reasons.items()}
    return cells


# The cell for shapes that collide as convex parts or similar primitives, which lowering chooses for all targets.
SIMPLIFIED_COLLIDERS = SupportCell(
    Fidelity.APPROXIMATED, "All targets use the same simplified shapes; the loss report states the deviation."
)


# The reason why formats contain no random values.
NO_RANDOM_VALUES = "Files contain one scene; generate cousins with `simfoundry cousins`, and compile their folder."


def _of_objects(label: str, test: Callable[[SceneObject], object], quantity: str, group: str = "object") -> Feature:
    return Feature(group, label, lambda scene: [item.name for item in scene.objects if test(item)], quantity)


def _of_colliders(label: str, test: Callable[[Collider], object], quantity: str = "colliders") -> Feature:
    return _of_objects(label, lambda item: any(test(c) for k in item.links for c in k.colliders), quantity, "body")


def _of_joints(label: str, test: Callable[[Joint], object], quantity: str = "") -> Feature:
    def users(scene: Scene) -> list[str]:
        return [f"{item.name}.{joint.name}" for item in scene.objects for joint in item.joints if test(joint)]

    return Feature("joint", label, users, quantity)


def _several_axes(scene: Scene) -> list[str]:
    found = [(item, above) for item in scene.objects for above in item.joints_above.values() if len(above) > 1]
    return [f"{item.name}.{joint.name}" for item, above in found for joint in above]


def _of_lights(label: str, kind: LightType) -> Feature:
    return Feature("scene", label, lambda scene: [light.name for light in scene.lights if light.type is kind])


def _panoramas(scene: Scene) -> list[str]:
    return [light.name for light in scene.lights if light.panorama is not None]


def _is_textured(item: SceneObject) -> bool:
    meshes = (v.geometry for link in item.links for v in link.visuals if isinstance(v.geometry, Mesh))
    return any(has_texture(mesh) for mesh in meshes)


def _of_attached(label: str, field: str) -> Feature:
    return Feature(
        "object", label, lambda scene: [f"{o.name}.{each.name}" for o in scene.objects for each in getattr(o, field)]
    )


# What the elements of the sections of native data are called in the singular and the plural.
_NATIVE_WORDS = {
    "asset": ("height field", "height fields"),
    "worldbody": ("site", "sites"),
    "contact": ("contact pair", "contact pairs"),
    "tendon": ("tendon", "tendons"),
    "equality": ("equality", "equalities"),
    "actuator": ("actuator", "actuators"),
    "sensor": ("sensor", "sensors"),
    "custom": ("custom value", "custom values"),
    "keyframe": ("keyframe", "keyframes"),
    "settings": ("setting", "settings"),
    "links": ("link", "links"),
    "joints": ("joint", "joints"),
    "parts": ("part", "parts"),
}


def native_count(scene: Scene) -> dict[str, int]:
    """Return the number of elements, settings and sets of attributes that only MJCF knows, by their words.

    Exact values are not counted, because the document states the same values.
    """
    counts = _section_counts(scene.native or {})
    for item in scene.objects:
        for key in ("links", "joints", "parts"):
            counts[key] += sum(bool(values.keys() - {"exact"}) for values in getattr(item.native, key).values())
    return _in_words(counts)


def native_words(data: Mapping[str, Any]) -> str:
    """Return what the native data of a scene contains, such as `2 tendons, 1 setting`."""
    return ", ".join(f"{count} {word}" for word, count in _in_words(_section_counts(data)).items())


def _section_counts(data: Mapping[str, Any]) -> Counter[str]:
    counts = Counter({key: len(value) for key, value in data.items() if key in _NATIVE_WORDS})
    counts["settings"] = sum(len(v) for k, v in data.items() if k not in _NATIVE_WORDS and k != "order")
    return counts


def _in_words(counts: Counter[str]) -> dict[str, int]:
    return {_NATIVE_WORDS[key][count > 1]: count for key, count in counts.items() if count}


def _excluded(scene: Scene) -> list[str]:
    return [item.name for item in scene.objects if item.no_contact] + ["no_contact"] * bool(scene.no_contact)


def _left_out(scene: Scene, section: str) -> list[str]:
    return [part.path for part in scene.left_out if part.path.startswith(f"{section}.")]


def _of_robots(label: str, quantity: str = "") -> Feature:
    """Return a feature that every robot uses. A robot without a model also loses its motors and surfaces."""
    return Feature("scene", label, lambda s: [*(r.name for r in s.robots), *_left_out(s, "robots")], quantity)


def _mounted_cameras(scene: Scene) -> list[str]:
    return [*(mounted.camera.name for mounted in scene.mounted), *_left_out(scene, "cameras")]


def _of_background(label: str, field: str) -> Feature:
    return Feature("scene", label, lambda s: ["background"] * bool(s.background and getattr(s.background, field)))


# All features by name, in the order in which reports list them.
FEATURES: dict[str, Feature] = {
    "gravity": Feature("scene", "gravity", lambda s: [s.name]),
    "relations": Feature("scene", "stated relations", lambda s: [str(r) for r in s.relations]),
    "robots": _of_robots("robots: base, links, joints"),
    "robot_motors": _of_robots("robot motors", "actuators"),
    "robot_contacts": _of_robots("robot surfaces", "friction"),
    "mounted_cameras": Feature("scene", "cameras on robots and objects", _mounted_cameras),
    "cameras": Feature("scene", "cameras: pose and intrinsics", lambda s: [c.name for c in s.cameras]),
    "distant_lights": _of_lights("distant lights", LightType.DISTANT),
    "point_lights": _of_lights("point lights", LightType.POINT),
    "dome_lights": _of_lights("dome lights", LightType.DOME),
    "dome_textures": Feature("scene", "panoramas of dome lights", _panoramas, "texture"),
    "background_mesh": _of_background("background mesh", "visuals"),
    "background_splat": _of_background("Gaussian splat background", "splat"),
    "options": Feature("scene", "time step and solver", lambda s: ["options"] * (s.options != Options())),
    "vary": Feature("scene", "random values of a recipe", lambda s: [value.name for value in s.random_values]),
    "native": Feature("scene", "data of one format", lambda s: ["native.mjcf"] * bool(native_count(s))),
    "pose": _of_objects("pose in the world", lambda o: True, "pose"),
    "fixed": _of_objects("welded to the world", lambda o: o.fixed, "fixed"),
    "category": _of_objects("category", lambda o: o.category, "category"),
    "labels": _of_objects("semantic labels", lambda o: o.labels, "labels"),
    "variants": _of_objects("variants", lambda o: o.variants, "variants"),
    "visuals": _of_objects("visual shapes and their color", lambda o: any(k.visuals for k in o.links), "visuals"),
    "texture": _of_objects("textures", _is_textured, "texture"),
    "sites": _of_attached("sites", "sites"),
    "sensors": _of_attached("sensors", "sensors"),
    "actuators": _of_attached("actuators", "actuators"),
    "mass": _of_objects("mass", lambda o: True, "mass", "body"),
    "inertia": _of_objects("center of mass and inertia", lambda o: True, "inertia", "body"),
    "gravity_compensation": _of_objects("gravity compensation of links",
                                        lambda o: any(k.gravity_compensation for k in o.links),
                                        "gravity_compensation", "body"),
    "box": _of_colliders("collision boxes", lambda c: isinstance(c.geometry, Box)),
    "sphere": _of_colliders("collision spheres", lambda c: isinstance(c.geometry, Sphere)),
    "cylinder": _of_colliders("collision cylinders", lambda c: isinstance(c.geometry, Cylinder)),
    "capsule": _of_colliders("collision capsules", lambda c: isinstance(c.geometry, Capsule)),
    "ellipsoid": _of_colliders("collision ellipsoids", lambda c: isinstance(c.geometry, Ellipsoid)),
    "cone": _of_colliders("collision cones", lambda c: isinstance(c.geometry, Cone)),
    "convex_mesh": _of_colliders("convex collision meshes", lambda c: isinstance(c.geometry, Mesh)),
    "collision_shape": _of_objects("round and hollow shapes with simplified colliders",
                                   lambda o: any(k.collision_error for k in o.links), "colliders", "body"),
    "friction": _of_colliders("pairwise friction (geometric mean)", lambda c: True, "friction"),
    "restitution": _of_colliders("pairwise restitution (geometric mean)", lambda c: True, "restitution"),
    "torsional_friction": _of_colliders("torsional friction", lambda c: c.torsional_friction > 0, "torsional_friction"),
    "rolling_friction": _of_colliders("rolling friction", lambda c: c.rolling_friction > 0, "rolling_friction"),
    "no_contact": Feature("body", "excluded pairs", _excluded, "no_contact"),
    "fixed_joint": _of_joints("fixed joints", lambda j: j.type is JointType.FIXED),
    "revolute": _of_joints("revolute joints", lambda j: j.type is JointType.REVOLUTE),
    "continuous": _of_joints("continuous joints", lambda j: j.type is JointType.CONTINUOUS),
    "prismatic": _of_joints("prismatic joints", lambda j: j.type is JointType.PRISMATIC),
    "ball": _of_joints("ball joints", lambda j: j.type is JointType.BALL),
    "free": _of_joints("free joints", lambda j: j.type is JointType.FREE),
    "several_axes": Feature("joint", "joints with several axes", _several_axes, "axes"),
    "mimic": _of_joints("mimic joints", lambda j: j.mimic is not None, "mimic"),
    "drive": _of_joints("joint drives", lambda j: j.drive is not None, "drive"),
    "joint_position": _of_joints("joint positions", lambda j: j.type is not JointType.FIXED, "position"),
    "joint_limits": _of_joints("joint limits", lambda j: j.limits or j.type is JointType.PRISMATIC, "limits"),
    "joint_closed": _of_joints("limit at which a joint is closed", lambda j: j.closed is not None, "closed"),
    "joint_damping": _of_joints("viscous joint damping", lambda j: j.damping > 0, "damping"),
    "joint_friction": _of_joints("Coulomb joint friction", lambda j: j.friction > 0, "friction"),
    "armature": _of_joints("armature", lambda j: j.armature > 0, "armature"),
    "joint_effort": _of_joints("effort limits of joints", lambda j: j.effort is not None, "effort"),
    "joint_velocity": _of_joints("velocity limits of joints", lambda j: j.velocity is not None, "velocity"),
}  # fmt: skip
