"""Losses that occur in PyBullet. The fidelity of each feature is listed in ``features.yaml``."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from simfoundry.backends.artifact import number
from simfoundry.backends.features import read_cells
from simfoundry.backends.losses import Loss, approximate, attachment_losses, drop, splat_losses, variant_losses
from simfoundry.backends.pybullet.surfaces import SKIN, Resistances, link_mean
from simfoundry.backends.stable_drives import stiffness_losses
from simfoundry.backends.urdf.features import joint_losses
from simfoundry.geometry.shapes import Mesh
from simfoundry.scene.model import Light, LightType, Link, Scene, SceneObject

FEATURES = read_cells(Path(__file__).parent)

_MARGIN = (
    "Bullet's collision margin rounds edges of convex meshes by 1 mm and sharp tips by more, and thickens meshes that "
    "are thinner than the margin."
)
_LIGHTS = {
    LightType.DISTANT: "PyBullet uses its own shading model: the brightness differs, and shadows are soft.",
    LightType.POINT: "PyBullet replaces the point light with parallel rays from its position toward the origin.",
    LightType.DOME: "PyBullet adds the light's mean intensity, without its color, to the ambient light.",
}


def bullet_losses(scene: Scene, timestep: float, resistances: Resistances) -> Iterator[Loss]:
    """Yield the losses that occur when a scene is loaded in PyBullet, excluding those of its robots.

    ``timestep`` is the time step of the simulation [s].
    """
    colliders = [collider for item in scene.objects for link in item.links for collider in link.colliders]
    if any(collider.friction > 0 for collider in colliders):
        reason = "Bullet's friction depends on direction; between the two friction axes, it is up to 9% too low."
        yield approximate("friction", "", reason, 9, "%")
    if any(collider.restitution > 0 for collider in colliders):
        reason = "Bullet resolves impacts at step boundaries; the rebound differs from the coefficient by up to 0.15."
        yield approximate("restitution", "", reason, 0.15)
    for field, found in resistances.items():
        if found.error > 1e-9:  # ignores rounding errors
            reason = f"{FEATURES[field].reason} The worst pair is off by {found.error:.0%}."
            yield approximate(field, "", reason, 100 * found.error, "%")
    for item in scene.objects:
        for link in item.links:
            yield from _surface_losses(item, link)
        if any(isinstance(collider.geometry, Mesh) for link in item.links for collider in link.colliders):
            yield approximate("convex_mesh", item.name, _MARGIN, 1000 * SKIN, "mm")
        yield from joint_losses(item)
    yield from stiffness_losses(scene, timestep, implicit_damping=False)
    main = main_light(scene.lights)
    for light in scene.lights:
        feature = f"{light.type.value}_lights"
        if light is main or light.type is LightType.DOME:
            yield approximate(feature, light.name, _LIGHTS[light.type])
        else:
            yield drop(feature, light.name, "PyBullet renders with one light; the first one is used.")
        if light.panorama is not None:
            yield drop("dome_textures", light.name, FEATURES["dome_textures"].reason)
    yield from attachment_losses(scene, FEATURES, drives=True)
    yield from splat_losses(scene, "PyBullet")
    yield from variant_losses(scene, "PyBullet")


def _surface_losses(item: SceneObject, link: Link) -> Iterator[Loss]:
    for field in ("friction", "restitution"):
        value, values = link_mean(link, field), sorted({getattr(collider, field) for collider in link.colliders})
        if len(values) > 1:
            span = ", ".join(number(v) for v in values)
            reason = f"Bullet has one {field} per link: {number(round(value, 4))} replaces {span}."
            yield approximate(field, item.qualified(link.name), reason, max(abs(v - value) for v in values))


def main_light(lights: tuple[Light, ...]) -> Light | None:
    """Return the only light that PyBullet can render: the first one that is not a dome."""
    return next((light for light in lights if light.type is not LightType.DOME), None)
