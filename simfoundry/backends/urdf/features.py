"""The features that URDF and the manifests beside it keep, and the losses of a scene in them."""

from __future__ import annotations

from collections.abc import Iterator

from simfoundry.backends.artifact import number
from simfoundry.backends.features import SupportCell, approximated, dropped, exact
from simfoundry.backends.losses import Loss, approximate, drop, splat_losses, variant_losses
from simfoundry.backends.robot_models.robot_urdf import CONVERTED
from simfoundry.scene.kinematics import contact_pairs
from simfoundry.scene.model import JointType, Scene, SceneObject

UNBOUNDED_M = 1000.0
"""Where a sliding joint without limits ends [m]: far beyond any table, and exact in single precision."""

_NO_SURFACES = "URDF has no contact friction; the simulator's default applies."
_NO_CAMERAS = "URDF has no cameras; add one in the simulator."
_NO_LIGHTS = "URDF has no lights; the simulator's own are used."
_NO_WORLD = "URDF describes single objects, not their surroundings."
_NO_RELATIONS = "URDF describes single objects, not the relations among them."
_NO_GRAVITY = "URDF has no world settings; set gravity in the simulator."
_NO_RESTITUTION = "URDF has no restitution; the simulator's default applies."
_NO_DRIVES = "URDF has no drives; the force limit is kept as the joint's effort."
_NO_MOTORS = "URDF has no motors; nothing holds the joints until the simulator drives them."
_NO_BALLS = "URDF has no ball joints; the link is welded in its initial pose."
_NO_EXCLUSIONS = "URDF cannot exclude contacts; the simulator decides whether links of one object collide."
_NO_ARMATURE = "URDF has no rotor inertia; the joint accelerates as if it were zero."

FEATURES: dict[str, SupportCell] = {
    "robots": approximated(CONVERTED),
    "robot_motors": dropped(_NO_MOTORS),
    "robot_contacts": dropped(_NO_SURFACES),
    "mounted_cameras": dropped(_NO_CAMERAS),
    "gravity": dropped(_NO_GRAVITY),
    "relations": dropped(_NO_RELATIONS),
    "cameras": dropped(_NO_CAMERAS),
    "distant_lights": dropped(_NO_LIGHTS),
    "point_lights": dropped(_NO_LIGHTS),
    "dome_lights": dropped(_NO_LIGHTS),
    "background_mesh": dropped(_NO_WORLD),
    "background_splat": dropped(_NO_WORLD),
    **exact("pose", "fixed", "category", "labels", "visuals", "texture", "mass", "inertia"),
    "variants": dropped("A file holds one variant."),
    **exact("box", "sphere", "cylinder", "capsule", "convex_mesh"),
    "friction": dropped(_NO_SURFACES),
    "restitution": dropped(_NO_RESTITUTION),
    "torsional_friction": dropped(_NO_SURFACES),
    "rolling_friction": dropped(_NO_SURFACES),
    "no_contact": dropped(_NO_EXCLUSIONS),
    **exact("fixed_joint", "revolute", "continuous", "prismatic", "joint_position", "joint_limits", "joint_closed"),
    **exact("joint_damping", "joint_friction"),
    "armature": dropped(_NO_ARMATURE),
    "ball": dropped(_NO_BALLS),
    **exact("free", "mimic"),
    "drive": dropped(_NO_DRIVES),
}
"""The fidelity of each feature in URDF and the ``poses.json`` beside it."""


def urdf_losses(scene: Scene) -> Iterator[Loss]:
    """Yield the losses of a scene as URDF, except those of its robots."""
    yield drop("gravity", "", _NO_GRAVITY)
    for item in scene.objects:
        yield from _surface_losses(item)
        yield from joint_losses(item)
        for joint in item.joints:
            element = f"{item.name}.{joint.name}"
            if joint.type is JointType.BALL:
                yield drop("ball", element, _NO_BALLS)
            if joint.drive is not None:
                yield drop("drive", element, _NO_DRIVES)
        if contact_pairs(item) or item.no_contact:
            yield drop("no_contact", item.name, _NO_EXCLUSIONS)
    if scene.no_contact:
        yield drop("no_contact", "no_contact", _NO_EXCLUSIONS)
    for camera in scene.cameras:
        yield drop("cameras", camera.name, _NO_CAMERAS)
    for mounted in scene.mounted:
        yield drop("mounted_cameras", mounted.camera.name, _NO_CAMERAS)
    for light in scene.lights:
        yield drop(f"{light.type.value}_lights", light.name, _NO_LIGHTS)
    if scene.background is not None and scene.background.visuals:
        yield drop("background_mesh", "background", _NO_WORLD)
    yield from splat_losses(scene, "URDF")
    yield from variant_losses(scene, "URDF")
    if scene.relations:
        yield drop("relations", "", _NO_RELATIONS)


def robot_losses(name: str) -> Iterator[Loss]:
    """Yield what every robot loses in URDF, whichever model it has."""
    yield drop("robot_motors", name, _NO_MOTORS)
    yield drop("robot_contacts", name, _NO_SURFACES)


def _surface_losses(item: SceneObject) -> Iterator[Loss]:
    colliders = [collider for link in item.links for collider in link.colliders]
    if colliders:
        yield drop("friction", item.name, _NO_SURFACES)
    if any(collider.restitution > 0 for collider in colliders):
        yield drop("restitution", item.name, _NO_RESTITUTION)
    for field in ("torsional_friction", "rolling_friction"):
        if any(getattr(collider, field) > 0 for collider in colliders):
            yield drop(field, item.name, _NO_SURFACES)


def joint_losses(item: SceneObject) -> Iterator[Loss]:
    """Yield what the joints of an object lose in any dialect of URDF: armature, and prismatic joints without limits."""
    for joint in item.joints:
        element = f"{item.name}.{joint.name}"
        if joint.type is JointType.PRISMATIC and joint.limits is None:
            reason = f"URDF requires limits for prismatic joints; {number(UNBOUNDED_M)} m both ways replace them."
            yield approximate("joint_limits", element, reason, UNBOUNDED_M, "m")
        if joint.armature > 0:
            yield drop("armature", element, _NO_ARMATURE)
