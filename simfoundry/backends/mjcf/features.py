"""What MJCF keeps of each feature, and why not where it does not."""

from __future__ import annotations

from simfoundry.backends.features import Cell, approximated, dropped, exact

FEATURES: dict[str, Cell] = {
    "robots": Cell(reason="its own MJCF; else its URDF as MuJoCo reads it, with hulls as colliders"),
    "robot_motors": Cell(reason="a model without actuators gets a stiff servo in each joint"),
    "robot_contacts": approximated("as its file has them; against the scene's, MuJoCo takes the larger friction"),
    **exact("mounted_cameras"),
    **exact("gravity", "relations", "cameras", "distant_lights", "point_lights", "background_mesh"),
    "dome_lights": approximated("its colour lights everything alike, without shading"),
    "background_splat": dropped("MuJoCo shows surfaces only"),
    **exact("pose", "fixed", "category", "labels", "visuals", "texture", "mass", "inertia"),
    "variants": dropped("a file holds one of them"),
    **exact("box", "sphere", "cylinder", "capsule", "convex_mesh", "friction"),
    "restitution": approximated("rebounds within 0.03 of it, but never below 0.10 to 0.14"),
    **exact("torsional_friction", "rolling_friction", "no_contact"),
    **exact("fixed_joint", "revolute", "continuous", "prismatic", "joint_position", "joint_limits", "joint_closed"),
    **exact("joint_damping", "joint_friction", "armature"),
    **exact("ball", "free", "mimic"),
    "drive": Cell(reason="up to the stiffness that its steps can carry"),
}
