"""Losses that occur in a USD stage. The fidelity of each feature is listed in ``features.yaml``."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from simfoundry.backends.features import read_cells
from simfoundry.backends.losses import Loss, approximate, attachment_losses, drop
from simfoundry.backends.usd.bodies import is_static
from simfoundry.backends.usd.shapes import texture_of
from simfoundry.geometry.shapes import Mesh
from simfoundry.scene.kinematics import trees
from simfoundry.scene.model import Collider, Joint, JointType, LightType, Scene, SceneObject

# PhysX's limit on the number of vertices of a convex hull, from its documentation of ``PxConvexMeshDesc``.
HULL_VERTICES = 64

FEATURES = read_cells(Path(__file__).parent)


def usd_losses(scene: Scene) -> tuple[Loss, ...]:
    """Return the losses that occur when ``scene`` is written as a stage, in scene order."""
    every = [item for each in scene.objects for item in (each, *each.variants)]
    objects = dict.fromkeys(loss for item in every for loss in _object(item))
    return (*_contacts(every), *objects, *_lights(scene), *attachment_losses(scene, FEATURES, drives=True))


def _contacts(objects: Iterable[SceneObject]) -> Iterator[Loss]:
    """Yield the friction and restitution losses. Both quantities are exact only with PhysX's combine modes."""
    colliders = [c for item in objects for link in item.links for c in link.colliders]
    for name in ("friction", "restitution"):
        values = [float(getattr(collider, name)) for collider in colliders]
        worst = max(values, key=lambda v: abs(math.sqrt(v) - v), default=0.0)
        if math.sqrt(worst) != worst:
            reason = (
                f"The square root of the {name} is written with PhysX's `multiply` combine mode, which yields the "
                f"geometric mean. A plain UsdPhysics reader that averages the stored values gets up to "
                f"{math.sqrt(worst):.3g} instead of {worst:.3g}; "
                f"for such readers, `load(own_{name}=True)` in load.py sets the surface's own value."
            )
            yield approximate(name, "", reason, abs(math.sqrt(worst) - worst))
    for name in ("torsional_friction", "rolling_friction"):
        if any(getattr(collider, name) for collider in colliders):
            yield drop(name, "", FEATURES[name].reason)


def _object(item: SceneObject) -> Iterator[Loss]:
    for tree in trees(item):
        for joint in tree.joints:
            element = f"{item.name}.{joint.name}"
            if is_static(tree):
                yield drop("fixed_joint", element, "The object cannot move, so its links become one static body.")
            else:
                yield from _joint(element, joint, {j.name: j for j in tree.joints})
    for link in item.links:
        for visual in link.visuals:
            if isinstance(visual.geometry, Mesh) and visual.geometry.texture and texture_of(visual) is None:
                yield drop("texture", f"{item.name}.{link.name}.{visual.name}", "The mesh has no texture coordinates.")
        for collider in link.colliders:
            yield from _hull(f"{item.name}.{link.name}.{collider.name}", collider)


def _joint(element: str, joint: Joint, by_name: Mapping[str, Joint]) -> Iterator[Loss]:
    if joint.type is JointType.BALL:
        for field in ("damping", "friction"):
            if getattr(joint, field):
                yield drop(f"joint_{field}", element, f"PhysX's ball joints have no {field}; Newton reads it.")
    if joint.mimic is not None:
        leader = by_name.get(joint.mimic.joint)
        slides = [j is not None and j.type is JointType.PRISMATIC for j in (joint, leader)]
        if slides[0] != slides[1]:
            reason = "In PhysX and Newton, a prismatic or revolute joint can only follow a joint of the same type."
            yield drop("mimic", element, reason)


def _hull(element: str, collider: Collider) -> Iterator[Loss]:
    if isinstance(collider.geometry, Mesh) and len(collider.geometry.vertices) > HULL_VERTICES:
        count = len(collider.geometry.vertices)
        reason = f"PhysX keeps only {HULL_VERTICES} of the hull's {count} vertices."
        yield approximate("convex_mesh", element, reason, count - HULL_VERTICES, "vertices")


def _lights(scene: Scene) -> Iterator[Loss]:
    for light in scene.lights:
        if light.type is LightType.POINT:
            yield approximate("point_lights", light.name, FEATURES["point_lights"].reason)
