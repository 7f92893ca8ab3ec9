"""The URDF backend, which writes one URDF per object, and ``poses.json`` with the poses and joint positions.

``physics.json`` contains additional physical properties, which the loaders for Drake, Genesis and SAPIEN use.

A free object is written as a robot whose root is not attached to anything. Joints of type ``floating`` are never
written, because PyBullet freezes them and Drake loses their poses. Inertial frames are aligned with their links, and
products of inertia are written explicitly, because some readers ignore the rotation of an inertial frame. Links, joints
and colliders keep their names from the scene, and the URDF's robot is named after the object.
"""

from __future__ import annotations

from dataclasses import replace

from simfoundry.backends.artifact import Artifact, Backend, json_text
from simfoundry.backends.convex_hulls import REPLACED, hull_losses, with_hulls
from simfoundry.backends.light_links import light_link_losses, with_light_links
from simfoundry.backends.losses import Loss
from simfoundry.backends.names import check_names
from simfoundry.backends.robot_models.mujoco_robot import document_fields
from simfoundry.backends.robot_models.robot_object import RobotUrdf, robot_urdf, without_model
from simfoundry.backends.urdf.elements import Dialect, capsule_parts, urdf_files
from simfoundry.backends.urdf.features import FEATURES, robot_losses, urdf_losses
from simfoundry.backends.urdf.manifests import physics_manifest, poses_entry, robot_placement
from simfoundry.runtime.files import shipped
from simfoundry.scene.kinematics import trees
from simfoundry.scene.model import Scene

# The loaders in a build, with the ``targets/`` folder from which each of them is copied.
_LOADERS = {"load.py": "urdf"} | {f"load_{simulator}.py": simulator for simulator in ("drake", "genesis", "sapien")}


def compile_urdf(scene: Scene) -> Artifact:
    """Compile a scene to URDFs.

    Raises:
        InvalidSceneError: If a name is invalid.
    """
    check_names(scene)
    hulls = hull_losses(scene, REPLACED["urdf"])
    given = with_hulls(scene, REPLACED["urdf"])
    scene = with_light_links(given)
    dialect = Dialect(visual=capsule_parts, collision=capsule_parts)
    files = urdf_files(scene, dialect)
    poses = {tree.name: poses_entry(tree) for item in scene.objects for tree in trees(item)}
    losses: list[Loss] = [*urdf_losses(given), *light_link_losses(given, "URDF"), *hulls]
    robots: dict[str, RobotUrdf] = {}
    for robot in scene.robots:
        found = robot_urdf(robot, lambda item: urdf_files(replace(scene, objects=(item,)), dialect))
        if found is None:
            losses.append(without_model(robot.name))
            continue
        files |= found.files
        losses += [*found.losses, *robot_losses(robot.name)]
        robots[robot.name] = found
        fields = document_fields(robot)
        poses[robot.name] = robot_placement(found) | ({} if fields is None else {"robot": fields})
    files["poses.json"] = json_text(poses)
    files["physics.json"] = physics_manifest(scene, capsule_parts, robots)
    files |= {name: (shipped("targets") / folder / "load.py").read_bytes() for name, folder in _LOADERS.items()}
    return Artifact("urdf", "poses.json", files, tuple(losses))


BACKEND = Backend(compile_urdf, FEATURES)
