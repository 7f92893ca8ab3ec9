"""The features that MJCF keeps, with the reason for each that it does not keep exactly."""

from __future__ import annotations

from collections.abc import Iterator

from simfoundry.backends.features import SupportCell, approximated, dropped, exact
from simfoundry.backends.losses import Loss, approximate
from simfoundry.scene.model import Scene

FEATURES: dict[str, SupportCell] = {
    "robots": SupportCell(
        reason="A robot's own MJCF, else its URDF as read by MuJoCo, with convex hulls as colliders."
    ),
    "robot_motors": SupportCell(reason="A model without actuators gets a stiff servo in each joint."),
    "robot_contacts": approximated(
        "As in the robot's file; in contacts with the scene, MuJoCo uses the larger friction."
    ),
    **exact("mounted_cameras", "gravity", "relations", "cameras", "distant_lights", "point_lights", "background_mesh"),
    "dome_lights": approximated("Its color lights all surfaces equally, without shading."),
    "background_splat": dropped("MuJoCo renders surfaces only."),
    **exact("pose", "fixed", "category", "labels", "visuals", "texture", "mass", "inertia"),
    "variants": dropped("A file holds one variant."),
    **exact("box", "sphere", "cylinder", "capsule", "convex_mesh", "friction"),
    "restitution": approximated("The rebound is within 0.03 of the coefficient, but never below 0.10 to 0.14."),
    **exact("torsional_friction", "rolling_friction", "no_contact"),
    **exact("fixed_joint", "revolute", "continuous", "prismatic", "joint_position", "joint_limits", "joint_closed"),
    **exact("joint_damping", "joint_friction", "armature"),
    **exact("ball", "free", "mimic"),
    "drive": SupportCell(reason="Exact up to the stiffness that is stable at the timestep."),
}
"""The fidelity of each feature in MJCF."""


def restitution_losses(scene: Scene) -> Iterator[Loss]:
    """Yield one loss for each object that bounces, and one for all that should not and do a little."""
    reason = "MuJoCo has no restitution; contact damping makes rebounds within 0.03 of it, but never below 0.14."
    bouncing = {o.name: [c.restitution for link in o.links for c in link.colliders] for o in scene.objects}
    yield from (approximate("restitution", name, reason, 0.03) for name, values in bouncing.items() if any(values))
    if any(e == 0 for values in bouncing.values() for e in values):
        still = "MuJoCo's soft contacts rebound at 0.10 to 0.14 of the impact speed where the scene states 0."
        yield approximate("restitution", "", still, 0.14)
