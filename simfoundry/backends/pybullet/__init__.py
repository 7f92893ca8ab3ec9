"""PyBullet: URDFs, a loader, and ``world.json`` with data that URDF cannot represent.

A link has one friction coefficient for all of its colliders; see :mod:`simfoundry.backends.pybullet.surfaces`. Bullet
adds a margin around convex meshes that cannot be disabled; the meshes are shrunk by this margin so that their effective
faces are in the correct place.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from simfoundry.backends.artifact import Artifact, json_text, rounded, rounded_list
from simfoundry.backends.backend import Backend
from simfoundry.backends.names import check_names
from simfoundry.backends.pybullet.features import FEATURES, bullet_losses
from simfoundry.backends.pybullet.inset import split_under_skin
from simfoundry.backends.pybullet.pictures import camera_arguments, lighting_arguments
from simfoundry.backends.pybullet.robots import GRASP_ITERATIONS, bullet_robots, robot_entry, with_rotors
from simfoundry.backends.pybullet.surfaces import Resistances, scene_resistances, surface_data
from simfoundry.backends.stable_drives import stable_drives
from simfoundry.backends.urdf.elements import Dialect, background_urdf, urdf_files, whole
from simfoundry.backends.urdf.manifests import (
    drive_data,
    excluded_between,
    excluded_within,
    mimic_data,
    placement,
    semantics,
)
from simfoundry.runtime.files import shipped
from simfoundry.scene.kinematics import Tree, contact_pairs, trees
from simfoundry.scene.model import Joint, JointType, Scene, SceneObject

TIMESTEP = 1 / 500
"""Time step [s]: half of Bullet's default and equal to the other targets, so that behaviors are comparable."""

BACKGROUND = "_background.urdf"
"""The file of the background; no object can have this name."""

_LOADER = shipped("targets/pybullet") / "load.py"


def compile_pybullet(scene: Scene, timestep: float = TIMESTEP) -> Artifact:
    """Compile a scene for PyBullet with time step ``timestep`` [s]; raise InvalidSceneError for invalid names."""
    check_names(scene)
    dialect = Dialect(visual=whole, collision=split_under_skin(), ball="spherical")
    files = urdf_files(scene, dialect)

    def write(item: SceneObject) -> Mapping[str, bytes]:
        return urdf_files(replace(scene, objects=(with_rotors(item),)), dialect)

    robots, robot_losses = bullet_robots(scene, write)
    for robot in robots.values():
        files.update(robot.files)
    resistances = scene_resistances(scene)
    parts = [tree for item in scene.objects for tree in trees(item)]
    world: dict[str, object] = {
        "gravity": rounded_list(scene.gravity),
        "timestep": timestep,
        "objects": {tree.name: _body(tree, resistances, timestep) for tree in parts},
        "cameras": {camera.name: camera_arguments(camera) for camera in scene.cameras},
        "lighting": lighting_arguments(scene.lights),
        "relations": [str(relation) for relation in scene.relations],
    }
    if robots:
        world["solver_iterations"] = GRASP_ITERATIONS
        world["robots"] = {name: robot_entry(robot, scene, timestep) for name, robot in robots.items()}
    if scene.background is not None and scene.background.visuals:
        files |= background_urdf(scene.background, files)
        world["background"] = BACKGROUND
    if between := excluded_between(scene):
        world["no_contact"] = between
    files["world.json"] = json_text(world)
    files["load.py"] = _LOADER.read_bytes()
    return Artifact("pybullet", "load.py", files, (*bullet_losses(scene, timestep, resistances), *robot_losses))


def _body(tree: Tree, resistances: Resistances, timestep: float) -> dict[str, object]:
    """Return the entry of one Bullet body, an object or a freely moving part of one; empty keys are omitted."""
    item = tree.owner
    moving = [joint for joint in tree.joints if joint.type is not JointType.FIXED]
    body: dict[str, object] = {
        "links": {link.name: surface_data(item, link, resistances) for link in tree.links},
        "joint_friction": {joint.name: rounded(joint.friction) for joint in moving},
        "joint_damping": {joint.name: rounded(joint.damping) for joint in moving},
    }
    if len(item.links) > 1:
        body |= {key: value for key, value in _articulation(tree, moving, timestep).items() if value}
    return {"urdf": f"{tree.name}.urdf"} | semantics(item) | placement(tree) | body


def _articulation(tree: Tree, moving: Sequence[Joint], timestep: float) -> dict[str, object]:
    """Return the joint motions and link contacts of one body."""
    item = tree.owner
    names, joints = {link.name for link in tree.links}, {joint.name for joint in tree.joints}
    touching = any(names.issuperset(pair) for pair in contact_pairs(item))
    drives = stable_drives(item, timestep, False)
    return {
        "balls": {j.name: rounded_list(j.motion.q) for j in moving if j.type is JointType.BALL},
        "mimics": {j.name: mimic_data(j.mimic) for j in moving if j.mimic is not None},
        "drives": {name: drive_data(drive) for name, drive in drives.items() if name in joints},
        "self_collision": touching,
        "no_contact": excluded_within(tree) if touching else [],
    }


BACKEND = Backend(compile_pybullet, FEATURES)
