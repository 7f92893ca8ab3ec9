"""The features that PyBullet keeps, and the losses of a scene in it."""

from __future__ import annotations

from collections.abc import Iterator

from simfoundry.backends.artifact import number
from simfoundry.backends.features import SupportCell, approximated, dropped, exact
from simfoundry.backends.losses import Loss, approximate, drop, splat_losses, variant_losses
from simfoundry.backends.pybullet.inset import SKIN
from simfoundry.backends.pybullet.pictures import main_light
from simfoundry.backends.pybullet.surfaces import Resistances, link_friction, link_restitution
from simfoundry.backends.robot_models.robot_urdf import CONVERTED
from simfoundry.backends.stable_drives import stiffness_losses
from simfoundry.backends.urdf.features import joint_losses
from simfoundry.geometry.shapes import Mesh
from simfoundry.scene.model import LightType, Link, Scene, SceneObject

_LIGHTS = {
    LightType.DISTANT: "PyBullet's surfaces respond to a light in their own way: brightness differs, shadows are soft.",
    LightType.POINT: "PyBullet casts parallel rays from its position towards the origin, and they do not spread.",
    LightType.DOME: "PyBullet adds its mean, without its color, to the light that every surface reflects.",
}
_MIXED = "It is mixed with the sliding friction, one number per link."

FEATURES: dict[str, SupportCell] = {
    "robots": approximated(CONVERTED),
    "robot_motors": approximated("Converted ones lag as in MuJoCo and do not sag; a URDF's hold with all their force."),
    "robot_contacts": approximated("A converted robot grips as in MuJoCo where the scene's frictions are equal."),
    "mounted_cameras": dropped("Cameras in its files stand still."),
    **exact("gravity", "relations", "cameras", "background_mesh"),
    "distant_lights": approximated("A picture has one light, the first; its brightness differs."),
    "point_lights": approximated("A picture has one light, the first, as parallel rays."),
    "dome_lights": approximated("Their mean, without color, lights everything alike."),
    "background_splat": dropped("PyBullet draws surfaces only."),
    **exact("pose", "fixed", "category", "labels", "visuals", "texture", "mass", "inertia"),
    "variants": dropped("A world holds one variant."),
    **exact("box", "sphere", "cylinder", "capsule"),
    "convex_mesh": approximated("Bullet's skin rounds edges by 1 mm."),
    "friction": approximated("It is up to 9 % less between its two axes."),
    "restitution": approximated("A rebound differs by up to 0.15."),
    "torsional_friction": approximated(_MIXED),
    "rolling_friction": approximated(_MIXED),
    **exact("no_contact"),
    **exact("fixed_joint", "revolute", "continuous", "prismatic", "joint_position", "joint_limits", "joint_closed"),
    **exact("joint_damping", "joint_friction"),
    "armature": dropped("URDF has no rotor inertia."),
    **exact("ball", "free", "mimic"),
    "drive": SupportCell(reason="Exact up to the stiffness that its steps can carry."),
}
"""The fidelity of each feature in PyBullet."""


def bullet_losses(scene: Scene, timestep: float, resistances: Resistances) -> Iterator[Loss]:
    """Yield the losses of a scene in PyBullet at steps of ``timestep`` [s], but for those of its robots."""
    colliders = [collider for item in scene.objects for link in item.links for collider in link.colliders]
    if any(collider.friction > 0 for collider in colliders):
        reason = "Bullet's friction depends on the direction: it is up to 9 % below Coulomb's between its two axes."
        yield approximate("friction", "", reason, 9, "%")
    if any(collider.restitution > 0 for collider in colliders):
        reason = "Bullet resolves an impact at whole steps: a rebound differs from the coefficient by up to 0.15."
        yield approximate("restitution", "", reason, 0.15)
    for field, found in resistances.items():
        if found.error > 1e-9:  # the rounding of a product
            reason = f"{_MIXED} The worst pair is {found.error:.0%} off."
            yield approximate(field, "", reason, 100 * found.error, "%")
    for item in scene.objects:
        for link in item.links:
            yield from _surface_losses(item, link)
        if any(isinstance(collider.geometry, Mesh) for link in item.links for collider in link.colliders):
            reason = (
                "Bullet's skin rounds the edges of convex meshes by 1 mm and sharp tips by more, or thickens meshes "
                "where they are thinner than it."
            )
            yield approximate("convex_mesh", item.name, reason, 1000 * SKIN, "mm")
        yield from joint_losses(item)
    yield from stiffness_losses(scene, timestep, implicit_damping=False)
    main = main_light(scene.lights)
    for light in scene.lights:
        feature = f"{light.type.value}_lights"
        if light is main or light.type is LightType.DOME:
            yield approximate(feature, light.name, _LIGHTS[light.type])
        else:
            yield drop(feature, light.name, "A picture of PyBullet has one light, and the first one is used.")
    yield from splat_losses(scene, "PyBullet")
    yield from variant_losses(scene, "PyBullet")


def _surface_losses(item: SceneObject, link: Link) -> Iterator[Loss]:
    for field, value in (("friction", link_friction(link)), ("restitution", link_restitution(link))):
        values = sorted({getattr(collider, field) for collider in link.colliders})
        if len(values) > 1:
            span = ", ".join(number(v) for v in values)
            reason = f"Bullet has one {field} per link: {number(round(value, 4))} stands for {span}."
            yield approximate(field, item.qualified(link.name), reason, max(abs(v - value) for v in values))
