"""What a stage cannot hold exactly, for whom, and by how much."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping

from simfoundry.backends.artifact import Fidelity, Loss
from simfoundry.backends.features import Cell, approximated, dropped, exact
from simfoundry.backends.robot_models.robot_urdf import ROBOT
from simfoundry.backends.usd.bodies import is_static
from simfoundry.backends.usd.materials import texture_of
from simfoundry.geometry.shapes import Mesh
from simfoundry.scene.model import Collider, Joint, JointType, LightType, Scene, SceneObject
from simfoundry.scene.trees import trees

HULL_VERTICES = 64  # PhysX's limit of a convex hull

FEATURES: dict[str, Cell] = {
    "robots": approximated(ROBOT),
    "robot_motors": Cell(reason="drives with the gains of the robot's file"),
    "robot_contacts": approximated("one friction a shape, combined as readers do: its file may mean otherwise"),
    **exact("mounted_cameras"),
    **exact("gravity", "relations", "cameras", "distant_lights"),
    "point_lights": approximated("falls off with the square of the distance; as stated at 1 m"),
    **exact("dome_lights", "background_mesh", "background_splat"),
    **exact("pose", "fixed", "category", "labels", "variants", "visuals", "texture", "mass", "inertia"),
    **exact("box", "sphere", "cylinder", "capsule"),
    "convex_mesh": Cell(reason=f"up to {HULL_VERTICES} vertices, PhysX's limit"),
    "friction": approximated("exact under PhysX's combine mode, which others do not know"),
    "restitution": approximated("exact under PhysX's combine mode, which others do not know"),
    "torsional_friction": dropped("PhysX has no place for it in USD; Newton reads it"),
    "rolling_friction": dropped("PhysX has no place for it in USD; Newton reads it"),
    **exact("no_contact"),
    "fixed_joint": Cell(reason="but in objects that cannot move, which are one body"),
    **exact("revolute", "continuous", "prismatic", "joint_position", "joint_limits", "joint_closed"),
    **exact("joint_damping", "joint_friction", "armature"),
    "ball": Cell(reason="without damping and friction, which PhysX has not"),
    **exact("free"),
    "mimic": Cell(reason="of its own kind: a slide a slide, a hinge a hinge"),
    **exact("drive"),
}
"""What USD keeps of each feature."""


def losses(scene: Scene) -> tuple[Loss, ...]:
    """The losses of ``scene`` as a stage, in the order of the scene."""
    every = [item for each in scene.objects for item in (each, *each.variants)]
    return (*_contacts(every), *dict.fromkeys(loss for item in every for loss in _object(item)), *_lights(scene))


def _contacts(objects: Iterable[SceneObject]) -> Iterator[Loss]:
    """Friction and restitution are exact only for readers that know PhysX's combine modes."""
    colliders = [c for item in objects for link in item.links for c in link.colliders]
    for name in ("friction", "restitution"):
        values = [float(getattr(collider, name)) for collider in colliders]
        worst = max(values, key=lambda v: abs(math.sqrt(v) - v), default=0.0)
        if math.sqrt(worst) != worst:
            reason = (
                f"written as the square root under PhysX's combine mode 'multiply', which makes the geometric mean; "
                f"a reader of plain UsdPhysics that averages, as Newton, sees up to {math.sqrt(worst):.3g} for "
                f"{worst:.3g} (load(own_{name}=True) in load.py gives it the surface's own value)"
            )
            yield Loss(name, Fidelity.APPROXIMATED, reason)
    for name in ("torsional_friction", "rolling_friction"):
        if any(getattr(collider, name) for collider in colliders):
            yield Loss(name, Fidelity.DROPPED, "PhysX has no place for it in USD; Newton reads it")


def _object(item: SceneObject) -> Iterator[Loss]:
    for tree in trees(item):
        for joint in tree.joints:
            path = f"{item.name}.{joint.name}"
            if is_static(tree):
                yield Loss(path, Fidelity.DROPPED, "a joint in an object that cannot move")
            else:
                yield from _joint(path, joint, {j.name: j for j in tree.joints})
    for link in item.links:
        for visual in link.visuals:
            if isinstance(visual.geometry, Mesh) and visual.geometry.texture and texture_of(visual) is None:
                reason = "the mesh has no texture coordinates"
                yield Loss(f"{item.name}.{link.name}.{visual.name}.texture", Fidelity.DROPPED, reason, "texture")
        for collider in link.colliders:
            yield from _hull(f"{item.name}.{link.name}.{collider.name}", collider)


def _joint(path: str, joint: Joint, by_name: Mapping[str, Joint]) -> Iterator[Loss]:
    if joint.type is JointType.BALL:
        for field in ("damping", "friction"):
            if getattr(joint, field):
                reason = f"PhysX's ball joints have no {field}; Newton reads it"
                yield Loss(f"{path}.{field}", Fidelity.DROPPED, reason)
    if joint.drive is not None and joint.drive.force_limit is not None and joint.damping:
        reason = "USD has one damping a joint: what it adds to the drive's counts towards the force limit"
        yield Loss(f"{path}.damping", Fidelity.APPROXIMATED, reason, "drive")
    if joint.mimic is not None:
        leader = by_name.get(joint.mimic.joint)
        slides = [j is not None and j.type is JointType.PRISMATIC for j in (joint, leader)]
        if slides[0] != slides[1]:
            reason = "PhysX and Newton let a joint follow only one of its kind, a slide a slide, a hinge a hinge"
            yield Loss(f"{path}.mimic", Fidelity.DROPPED, reason)


def _hull(path: str, collider: Collider) -> Iterator[Loss]:
    if isinstance(collider.geometry, Mesh) and len(collider.geometry.vertices) > HULL_VERTICES:
        reason = f"PhysX keeps {HULL_VERTICES} of the hull's {len(collider.geometry.vertices)} vertices"
        yield Loss(path, Fidelity.APPROXIMATED, reason, "convex_mesh")


def _lights(scene: Scene) -> Iterator[Loss]:
    for light in scene.lights:
        if light.type is LightType.POINT:
            reason = "its light falls off with the square of the distance, and has the stated intensity at 1 m"
            yield Loss(f"{light.name}.intensity", Fidelity.APPROXIMATED, reason)
