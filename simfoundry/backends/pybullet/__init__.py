"""The PyBullet backend, which writes URDFs, a loader, and ``world.json`` with the data that URDF cannot represent.

``world.json`` contains the surfaces and joint motions of the objects, the motors and frames of the robots, and the
``getCameraImage`` arguments for each camera.

Each link has a single friction coefficient for all of its colliders; see :mod:`simfoundry.backends.pybullet.surfaces`.
Bullet always adds a margin around convex meshes, so meshes are shrunk by this margin to keep their effective faces in
the correct place.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from simfoundry.backends.artifact import Artifact, Backend, json_text, rounded, rounded_list
from simfoundry.backends.convex_hulls import REPLACED, hull_losses, with_hulls
from simfoundry.backends.light_links import light_link_losses, with_light_links
from simfoundry.backends.losses import Loss, approximate, drop
from simfoundry.backends.names import check_names, check_timestep
from simfoundry.backends.pybullet import surfaces
from simfoundry.backends.pybullet.features import FEATURES, bullet_losses, main_light
from simfoundry.backends.robot_models.robot_object import RobotUrdf, Write, robot_urdf, without_model
from simfoundry.backends.stable_drives import stable_drives
from simfoundry.backends.urdf import manifests
from simfoundry.backends.urdf.elements import Dialect, background_urdf, urdf_files, whole
from simfoundry.geometry.frames import Array, frozen_array
from simfoundry.runtime.files import shipped
from simfoundry.scene.kinematics import Tree, contact_pairs, trees
from simfoundry.scene.model import Camera, Joint, JointType, Light, LightType, Scene, SceneObject

# Time step [s], about half of Bullet's default. All targets use the same step so that their behavior is comparable.
TIMESTEP = 1 / 500

# The file name of the background, which no object can have.
BACKGROUND = "_background.urdf"

# Solver iterations per step in scenes with robots. With Bullet's default of 50, a marker held by a 2F-85 gripper creeps
# by up to 2 cm and rotates while the arm moves. With 200 iterations it creeps by 5 mm; 500 iterations reduce this to 2
# mm but take three times as long.
GRASP_ITERATIONS = 200

# Share of the error of a position that Bullet's motors correct in each step by default.
BULLET_GAIN = 0.1

_GRIPS = {
    False: "Bullet multiplies the friction in the robot's file by the square root of the scene's friction.",
    True: "The robot grips as in MuJoCo, which uses the larger friction; with unequal frictions, this is approximate.",
}
# The reasons for the losses of robot surfaces and motors; the key is true if the robot was converted from its MJCF.
_MOTORS = {
    False: "Bullet's motors hold their joints with full force, regardless of the gains in the robot's file.",
    True: "The arm lags according to its gains but does not sag; rotor inertias are added to the links as disks.",
}

# The addition for a URDF whose gains the scene changes.
_OWN_GAINS = " Of the scene's `gains`, only the ratio of stiffness and damping acts: on the speed of the motors."

# Near and far clipping distances of the cameras [m]. A wrist camera sees its own fingers at 2 cm, and no room is larger
# than the far distance.
NEAR, FAR = 0.01, 100.0

_LOADER = shipped("targets/pybullet") / "load.py"


def compile_pybullet(scene: Scene, timestep: float = TIMESTEP) -> Artifact:
    """Compile a scene for PyBullet with a time step of ``timestep`` [s].

    Raises:
        InvalidSceneError: If a name or the time step is invalid.
    """
    if timestep == TIMESTEP and scene.options.timestep is not None:
        timestep = scene.options.timestep
    check_timestep(timestep)
    check_names(scene)
    hulls = tuple(hull_losses(scene, REPLACED["pybullet"]))
    given = with_hulls(scene, REPLACED["pybullet"])
    scene = with_light_links(given)
    dialect = Dialect(visual=whole, collision=surfaces.split_under_skin(), ball="spherical")
    files = urdf_files(scene, dialect)
    robots, robot_losses = bullet_robots(
        scene, lambda item: urdf_files(replace(scene, objects=(with_rotors(item),)), dialect)
    )
    for robot in robots.values():
        files.update(robot.files)
    resistances = surfaces.scene_resistances(scene)
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
    if between := manifests.excluded_between(scene):
        world["no_contact"] = between
    files["world.json"] = json_text(world)
    files["load.py"] = _LOADER.read_bytes()
    losses = (*bullet_losses(given, timestep, resistances), *light_link_losses(given, "URDF"), *hulls, *robot_losses)
    return Artifact("pybullet", "load.py", files, losses)


def _body(tree: Tree, resistances: surfaces.Resistances, timestep: float) -> dict[str, object]:
    """Return the entry for a Bullet body (an object or one of its freely moving parts), omitting empty keys."""
    item = tree.owner
    moving = [joint for joint in tree.joints if joint.type is not JointType.FIXED]
    body: dict[str, object] = {
        "links": {link.name: surfaces.surface_data(item, link, resistances) for link in tree.links},
        "joint_friction": {joint.name: rounded(joint.friction) for joint in moving},
        "joint_damping": {joint.name: rounded(joint.damping) for joint in moving},
    }
    if len(item.links) > 1:
        body |= {key: value for key, value in _articulation(tree, moving, timestep).items() if value}
    return {"urdf": f"{tree.name}.urdf"} | manifests.semantics(item) | manifests.placement(tree) | body


def _articulation(tree: Tree, moving: Sequence[Joint], timestep: float) -> dict[str, object]:
    """Return the ball joints, mimic joints, drives and collision settings of one body."""
    item = tree.owner
    names, joints = {link.name for link in tree.links}, {joint.name for joint in tree.joints}
    touching = any(names.issuperset(pair) for pair in contact_pairs(item))
    drives = stable_drives(item, timestep, False)
    return {
        "balls": {j.name: rounded_list(j.motion.q) for j in moving if j.type is JointType.BALL},
        "mimics": {j.name: manifests.mimic_data(j.mimic) for j in moving if j.mimic is not None},
        "drives": {name: manifests.drive_data(drive) for name, drive in drives.items() if name in joints},
        "velocities": {j.name: rounded(j.velocity) for j in moving if j.velocity is not None},
        "self_collision": touching,
        "no_contact": manifests.excluded_within(tree) if touching else [],
    }


def bullet_robots(scene: Scene, write: Write) -> tuple[dict[str, RobotUrdf], list[Loss]]:
    """Return the robots in a scene as URDFs, keyed by name, and the losses of the robots and mounted cameras."""
    robots, losses = {}, []
    for robot in scene.robots:
        found = robot_urdf(robot, write)
        if found is None:
            losses.append(without_model(robot.name))
            continue
        robots[robot.name] = found
        converted = found.item is not None
        losses += [*found.losses, approximate("robot_contacts", robot.name, _GRIPS[converted])]
        own = "" if converted or not robot.has_own_gains else _OWN_GAINS
        losses.append(approximate("robot_motors", robot.name, _MOTORS[converted] + own))
    for mounted in scene.mounted:
        reason = f"The camera is mounted on `{mounted.carrier}`, but cameras in PyBullet's files are static."
        losses.append(drop("mounted_cameras", mounted.camera.name, reason))
    return robots, losses


def robot_entry(robot: RobotUrdf, scene: Scene, timestep: float) -> dict[str, object]:
    """Return a robot's entry in ``world.json``, with its pose, motors and mimic joints."""
    motors = {
        name: {"target": rounded(position), "force": rounded(robot.efforts[name])} | _servo(robot, name, timestep)
        for name, position in robot.positions.items()
        if name in robot.efforts and name not in robot.follow
    }
    links = robot.item.links if robot.item is not None else ()
    frictions = {link.name: surfaces.robot_friction(link, scene) for link in links}
    return {
        "urdf": robot.path,
        **manifests.pose_data(robot.X_WB),
        "joints": {name: rounded(position) for name, position in robot.positions.items()},
        "motors": motors,
        "follow": {name: manifests.mimic_data(leader) for name, leader in robot.follow.items()},
        "links": {k: {"lateral_friction": rounded(mu), "restitution": 0.0} for k, mu in frictions.items()},
        "arm": dict(robot.joints),
        "gripper": {name: [rounded(v) for v in pair] for name, pair in robot.gripper.items()},
        "frames": {name: {"link": f.link, **manifests.pose_data(f.X_LF)} for name, f in robot.frames.items()},
    }


def _servo(robot: RobotUrdf, joint: str, timestep: float) -> dict[str, float]:
    """Return the gains of a servo for Bullet's motors, or nothing if they are unknown.

    Bullet's motors are velocity constraints. A spring and damper move a light joint at a velocity of ``stiffness *
    error / damping``, whereas Bullet's motor moves the joint by ``gain * error`` per step of ``timestep`` [s], using as
    much force as necessary. The loader's ``press`` function limits the force of gripper joints based on their
    stiffness, so the stiffness is included for them. For arm joints, which do not sag, this limit would only cause
    oscillations.
    """
    if joint not in robot.servos:
        is_scaled = robot.quickness != 1.0 and joint in robot.joints.values()
        return {"gain": rounded(min(BULLET_GAIN * robot.quickness, 1.0))} if is_scaled else {}
    stiffness, damping = robot.servos[joint]
    lag = {"gain": rounded(min(stiffness * timestep / damping, 1.0))} if damping > 0 else {}
    return lag | ({"stiffness": rounded(stiffness)} if joint in robot.gripper else {})


def with_rotors(item: SceneObject) -> SceneObject:
    """Return a copy of the object with the armature of each rotating joint added to the inertia of its child link.

    Most of a finger's inertia comes from its geared motor: up to a thousand times the inertia of its links. Bullet
    resolves contacts with a few dozen impulses per step, each proportional to the affected inertia. Without rotors, a
    finger with an inertia of 1e-5 kg m^2 would therefore press with only a hundredth of its motor's force. Each rotor
    is modeled as a thin disk with half of its inertia about the transverse axes, because Bullet treats a physically
    impossible inertia as zero.
    """
    links = {link.name: link for link in item.links}
    for joint in item.joints:
        if joint.armature > 0 and joint.type in (JointType.REVOLUTE, JointType.CONTINUOUS):
            rotor = joint.armature / 2 * (np.eye(3) + np.outer(joint.axis, joint.axis))
            link = links[joint.child]
            links[joint.child] = replace(link, inertia=frozen_array(link.inertia + rotor))
    return replace(item, links=tuple(links.values()))


def camera_arguments(camera: Camera) -> dict[str, object]:
    """Return a camera's image size, view matrix and projection matrix. As in OpenGL, the matrices are column-major."""
    view = np.diag([1.0, -1.0, -1.0, 1.0]) @ camera.X_WC.inverse().matrix
    matrices = {"view": rounded_list(view.T), "projection": rounded_list(projection_matrix(camera).T)}
    return {"width": camera.width, "height": camera.height, **matrices}


def projection_matrix(camera: Camera) -> Array:
    """Return the OpenGL projection matrix of a pinhole camera whose first pixel has its center at (0, 0).

    Returns:
        Projection matrix, shape (4, 4).
    """
    left, right = -(camera.cx + 0.5) / camera.fx, (camera.width - camera.cx - 0.5) / camera.fx
    top, bottom = (camera.cy + 0.5) / camera.fy, -(camera.height - camera.cy - 0.5) / camera.fy
    matrix = np.diag([2 / (right - left), 2 / (top - bottom), -(FAR + NEAR) / (FAR - NEAR), 0.0])
    matrix[:2, 2] = (right + left) / (right - left), (top + bottom) / (top - bottom)
    matrix[2, 3], matrix[3, 2] = -2 * FAR * NEAR / (FAR - NEAR), -1.0
    return matrix


def lighting_arguments(lights: tuple[Light, ...]) -> dict[str, object]:
    """Return the arguments for the main light and for the sum of all dome lights, or none if there are no lights."""
    if not lights:
        return {}
    dome = math.fsum(t.intensity * float(np.mean(t.rgb)) for t in lights if t.type is LightType.DOME)
    lighting: dict[str, object] = {"lightAmbientCoeff": rounded(dome), "lightSpecularCoeff": 0.0}
    main = main_light(lights)
    if main is None:
        return lighting | {"lightDiffuseCoeff": 0.0}
    toward = main.X_WL.rotation[:, 2] if main.type is LightType.DISTANT else main.X_WL.p
    color = {"lightDirection": rounded_list(toward), "lightColor": rounded_list(main.rgb)}
    return lighting | color | {"lightDiffuseCoeff": rounded(main.intensity)}


BACKEND = Backend(compile_pybullet, FEATURES)
