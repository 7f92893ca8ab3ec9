"""Losses that occur in URDF and its JSON manifests. The fidelity of each feature is listed in ``features.yaml``."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from simfoundry.backends.artifact import number
from simfoundry.backends.features import read_cells
from simfoundry.backends.losses import Loss, approximate, attachment_losses, drop, splat_losses, variant_losses
from simfoundry.scene.kinematics import contact_pairs
from simfoundry.scene.model import JointType, Scene, SceneObject

FEATURES = read_cells(Path(__file__).parent)

# Limit of a prismatic joint without limits [m], which is far beyond any table and exact in single precision.
UNBOUNDED_M = 1000.0

# Effort [N or N m] and velocity [m/s or rad/s] of joints without these limits, which URDF requires. No joint reaches
# this value, which PhysX also uses for joints without a velocity limit, so importers recognize it.
UNLIMITED = 1e6


def _drop(feature: str, element: str = "") -> Loss:
    return drop(feature, element, FEATURES[feature].reason)


def urdf_losses(scene: Scene) -> Iterator[Loss]:
    """Yield the losses that occur when a scene is written as URDF, excluding those of its robots."""
    yield _drop("gravity")
    for item in scene.objects:
        colliders = [collider for link in item.links for collider in link.colliders]
        if colliders:
            yield _drop("friction", item.name)
        for feature in ("restitution", "torsional_friction", "rolling_friction"):
            if any(getattr(collider, feature) > 0 for collider in colliders):
                yield _drop(feature, item.name)
        yield from joint_losses(item)
        for joint in item.joints:
            if joint.type is JointType.BALL:
                yield _drop("ball", f"{item.name}.{joint.name}")
            if joint.drive is not None:
                yield _drop("drive", f"{item.name}.{joint.name}")
        if contact_pairs(item) or item.no_contact:
            yield _drop("no_contact", item.name)
    if scene.no_contact:
        yield _drop("no_contact", "no_contact")
    yield from (_drop("cameras", camera.name) for camera in scene.cameras)
    yield from (_drop("mounted_cameras", mounted.camera.name) for mounted in scene.mounted)
    yield from (_drop(f"{light.type.value}_lights", light.name) for light in scene.lights)
    yield from (_drop("dome_textures", light.name) for light in scene.lights if light.panorama is not None)
    if scene.background is not None and scene.background.visuals:
        yield _drop("background_mesh", "background")
    yield from attachment_losses(scene, FEATURES, drives=False)
    yield from splat_losses(scene, "URDF")
    yield from variant_losses(scene, "URDF")
    if scene.relations:
        yield _drop("relations")


def robot_losses(name: str) -> tuple[Loss, Loss]:
    """Return the losses that apply to every robot in URDF, regardless of its model."""
    return _drop("robot_motors", name), _drop("robot_contacts", name)


def joint_losses(item: SceneObject) -> Iterator[Loss]:
    """Yield the losses of joints and links that occur in every URDF dialect.

    These concern armatures, prismatic joints without limits, and gravity compensation.
    """
    if any(link.gravity_compensation for link in item.links):
        yield _drop("gravity_compensation", item.name)
    for joint in item.joints:
        element = f"{item.name}.{joint.name}"
        if joint.type is JointType.PRISMATIC and joint.limits is None:
            reason = f"URDF requires limits for prismatic joints, so limits of ±{number(UNBOUNDED_M)} m are written."
            yield approximate("joint_limits", element, reason, UNBOUNDED_M, "m")
        if joint.armature > 0:
            yield _drop("armature", element)
