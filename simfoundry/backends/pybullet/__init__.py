"""PyBullet: the URDFs of the urdf backend, ``world.json`` with what URDF lacks, and a loader.

Bullet multiplies the frictions and restitutions of two bodies; each link therefore has the square root of its own, and
a pair the geometric mean of both. A link has one friction, however many colliders it has. Bullet puts a skin around
convex meshes that no setting removes; they are written smaller by that much, so that their faces are where they belong.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace

import numpy as np

from simfoundry.backends.artifact import Artifact, Fidelity, Loss, json_text, number, rounded
from simfoundry.backends.features import Cell, approximated, dropped, exact
from simfoundry.backends.names import check_names
from simfoundry.backends.pybullet.inset import inset_hull
from simfoundry.backends.pybullet.resistance import Resistance, resistance
from simfoundry.backends.pybullet.rotors import with_rotors
from simfoundry.backends.robot_models.robot_urdf import ROBOT, RobotUrdf, Write, robot_urdf
from simfoundry.backends.stable_drives import stable_drives, stiffness_losses
from simfoundry.backends.surroundings import splat_losses, variant_losses
from simfoundry.backends.urdf import (
    Dialect,
    Parts,
    background_urdf,
    joint_losses,
    meaning,
    placement,
    urdf_files,
    whole,
)
from simfoundry.backends.urdf.physics import silent_between
from simfoundry.geometry.frames import IDENTITY, Array, Pose
from simfoundry.geometry.shapes import Geometry, Mesh
from simfoundry.runtime.shipped import shipped
from simfoundry.scene.model import (
    Camera,
    Collider,
    Drive,
    Joint,
    JointType,
    Light,
    LightType,
    Link,
    Mimic,
    Scene,
    SceneObject,
)
from simfoundry.scene.touching import silent_pairs, touching_pairs
from simfoundry.scene.trees import Tree, trees

TIMESTEP = 1 / 500
"""Seconds a step."""

GRASP_ITERATIONS = 200
"""Iterations of Bullet's solver a step where there are robots. At its own 50 a marker between the pads of a 2F-85
creeps by up to 2 cm and turns on its way; at 200 by 5 mm, at 500 by 2 mm, for three times the time of 200."""

BACKGROUND = "_background.urdf"
"""The file of what is seen around the scene; no object is called so."""

_DOME = "PyBullet adds its mean, without its colour, to what everything reflects alike"
_SUN = {
    LightType.DISTANT: "PyBullet's surfaces answer to a light in its own way: brightness differs, shadows are soft",
    LightType.POINT: "PyBullet shines parallel rays from where it is to the origin, and they do not spread",
}

_GRIPS = {
    False: "its surfaces are as its file has them, and Bullet multiplies them with the roots of the scene's",
    True: "grips the scene's surfaces as in MuJoCo, which takes the larger friction; where they differ, in the middle",
}
_MOTORS = {
    False: "a motor of Bullet holds its joint with all its force, whatever the gains in the robot's file",
    True: "an arm follows with the lag of its gains, but does not sag; rotors are discs in the links that they turn",
}
"""What is lost of a robot's surfaces and motors, by whether it was converted from its MJCF."""

FEATURES: dict[str, Cell] = {
    "robots": approximated(ROBOT),
    "robot_motors": approximated("converted ones lag as in MuJoCo and do not sag; a URDF's hold with all their force"),
    "robot_contacts": approximated("a converted one grips as in MuJoCo where the scene's frictions are equal"),
    "mounted_cameras": dropped("cameras in its files stand still"),
    **exact("gravity", "relations", "cameras", "background_mesh"),
    "distant_lights": approximated("one light a picture: the first; its brightness differs"),
    "point_lights": approximated("one light a picture: the first, as parallel rays"),
    "dome_lights": approximated("their mean, without colour, lights everything alike"),
    "background_splat": dropped("PyBullet shows surfaces only"),
    **exact("pose", "fixed", "category", "labels", "visuals", "texture", "mass", "inertia"),
    "variants": dropped("a world holds one of them"),
    **exact("box", "sphere", "cylinder", "capsule"),
    "convex_mesh": approximated("its skin rounds edges by 1 mm"),
    "friction": approximated("up to 9 % less between its two axes"),
    "restitution": approximated("a rebound differs by up to 0.15"),
    "torsional_friction": approximated("mixed with the sliding friction, one number a link"),
    "rolling_friction": approximated("mixed with the sliding friction, one number a link"),
    **exact("no_contact"),
    **exact("fixed_joint", "revolute", "continuous", "prismatic", "joint_position", "joint_limits", "joint_closed"),
    **exact("joint_damping", "joint_friction"),
    "armature": dropped("URDF has no rotor inertia"),
    **exact("ball", "free", "mimic"),
    "drive": Cell(reason="up to the stiffness that its steps can carry"),
}
"""What PyBullet keeps of each feature."""

NEAR, FAR = 0.01, 100.0
"""Clipping distances of the cameras [m]."""

SKIN = 1e-3
"""Thickness of the skin around a convex mesh that is loaded from URDF [m]."""

_LOADER = shipped("targets/pybullet") / "load.py"


def compile_pybullet(scene: Scene, timestep: float = TIMESTEP) -> Artifact:
    """Compile a scene for PyBullet that steps by ``timestep`` [s]; InvalidSceneError for unusable names."""
    check_names(scene)
    dialect = Dialect(shown=whole, felt=_under_skin(), ball="spherical")
    files = urdf_files(scene, dialect)

    def write(item: SceneObject) -> Mapping[str, bytes]:
        return urdf_files(replace(scene, objects=(with_rotors(item),)), dialect)

    robots, lost = bullet_robots(scene, write)
    for robot in robots.values():
        files.update(robot.files)
    resistances = _resistances(scene)
    parts = [tree for item in scene.objects for tree in trees(item)]
    world: dict[str, object] = {
        "gravity": _numbers(scene.gravity),
        "timestep": timestep,
        "objects": {tree.name: _object(tree, resistances, timestep) for tree in parts},
        "cameras": {camera.name: camera_arguments(camera) for camera in scene.cameras},
        "lighting": lighting_arguments(scene.lights),
        "relations": [str(relation) for relation in scene.relations],
    }
    if robots:
        world["solver_iterations"] = GRASP_ITERATIONS
        world["robots"] = {name: _robot(robot, scene, timestep) for name, robot in robots.items()}
    if scene.background is not None and scene.background.visuals:
        files |= background_urdf(scene.background, files)
        world["background"] = BACKGROUND
    if between := silent_between(scene, parts):
        world["no_contact"] = between
    files["world.json"] = json_text(world)
    files["load.py"] = _LOADER.read_bytes()
    return Artifact("pybullet", "load.py", files, (*_losses(scene, timestep, resistances), *lost))


def bullet_robots(scene: Scene, write: Write) -> tuple[dict[str, RobotUrdf], list[Loss]]:
    """The robots of a scene as URDF by name, and what is lost with them and with the cameras that ride on links."""
    robots, losses = {}, []
    for robot in scene.robots:
        found = robot_urdf(robot, write)
        if found is None:
            reason = "it has no model in URDF or MJCF, and USD is not converted"
            losses.append(Loss(robot.name, Fidelity.DROPPED, reason))
            continue
        robots[robot.name] = found
        losses.extend(found.losses)
        losses.append(Loss(f"{robot.name}.friction", Fidelity.APPROXIMATED, _GRIPS[found.item is not None]))
        losses.append(Loss(f"{robot.name}.actuators", Fidelity.APPROXIMATED, _MOTORS[found.item is not None]))
    for mounted in scene.mounted:
        reason = f"it rides on `{mounted.carrier}`, and cameras in the files of PyBullet stand still"
        losses.append(Loss(mounted.camera.name, Fidelity.DROPPED, reason))
    return robots, losses


def _robot(robot: RobotUrdf, scene: Scene, timestep: float) -> dict[str, object]:
    """A robot in ``world.json``: where it stands, what its motors hold, and which joints follow others."""
    motors = {
        name: {"target": rounded(position), "force": rounded(robot.efforts[name])} | _servo(robot, name, timestep)
        for name, position in robot.positions.items()
        if name in robot.efforts and name not in robot.follow
    }
    follow = {
        name: {"joint": leader.joint, "multiplier": rounded(leader.multiplier), "offset": rounded(leader.offset)}
        for name, leader in robot.follow.items()
    }
    links = robot.item.links if robot.item is not None else ()
    surfaces = {k.name: {"lateral_friction": rounded(robot_friction(k, scene)), "restitution": 0.0} for k in links}
    return {
        "urdf": robot.path,
        "p": _numbers(robot.X_WB.p),
        "q_wxyz": _numbers(robot.X_WB.q),
        "joints": {name: rounded(position) for name, position in robot.positions.items()},
        "motors": motors,
        "follow": follow,
        "links": surfaces,
        "arm": dict(robot.joints),
        "gripper": {name: [rounded(v) for v in pair] for name, pair in robot.gripper.items()},
        "frames": {
            name: {"link": frame.link, "p": _numbers(frame.X_LF.p), "q_wxyz": _numbers(frame.X_LF.q)}
            for name, frame in robot.frames.items()
        },
    }


def _servo(robot: RobotUrdf, joint: str, timestep: float) -> dict[str, float]:
    """The gains of a servo for Bullet, whose motors are constraints on the speed; none where they are not known.

    A spring with a damper moves a light joint at ``stiffness * error / damping``. Bullet's motor moves it by ``gain *
    error`` in a step of ``timestep`` [s], with whatever force that needs. The joints of a gripper keep their stiffness:
    the loader's ``press`` bounds their force with it. An arm's do not sag, so that bound would only let them swing.
    """
    if joint not in robot.servos:
        return {}
    stiffness, damping = robot.servos[joint]
    lag = {"gain": rounded(min(stiffness * timestep / damping, 1.0))} if damping > 0 else {}
    firm = {"stiffness": rounded(stiffness)} if joint in robot.gripper else {}
    return lag | firm


def link_friction(link: Link) -> float:
    """The one coefficient that stands for all colliders of a link: their geometric mean."""
    return _geometric_mean([collider.friction for collider in link.colliders])


def robot_friction(link: Link, scene: Scene) -> float:
    """Return what Bullet is told of a link of a converted robot, so that it grips the scene's objects as in MuJoCo.

    MuJoCo takes the larger friction of the two, Bullet multiplies this with the square root of the object's: exact
    where all objects have one friction, in the middle where they have several.
    """
    own = link_friction(link)
    met = {link_friction(k) for item in scene.objects for k in item.links if k.colliders} - {0.0}
    wanted = [max(own, other) / math.sqrt(other) for other in met]
    return math.sqrt(min(wanted) * max(wanted)) if own and wanted else math.sqrt(own)


def link_restitution(link: Link) -> float:
    """The one restitution that stands for all colliders of a link: their geometric mean."""
    return _geometric_mean([collider.restitution for collider in link.colliders])


def _geometric_mean(values: list[float]) -> float:
    if not values or min(values) <= 0:
        return 0.0
    return values[0] if len(set(values)) == 1 else math.exp(math.fsum(map(math.log, values)) / len(values))


def _under_skin() -> Parts:
    """A split that gives each mesh as Bullet's skin will restore it; one too thin for that stays as it is."""
    done: dict[str, Mesh] = {}

    def parts(geometry: Geometry) -> Iterator[tuple[str, Geometry, Pose]]:
        if isinstance(geometry, Mesh):
            digest = geometry.digest
            if digest not in done:
                done[digest] = inset_hull(geometry, SKIN) or geometry
            geometry = done[digest]
        yield "", geometry, IDENTITY

    return parts


def _resistances(scene: Scene) -> dict[str, Resistance]:
    """What is written for the links' resistance against spinning and rolling."""

    def of(field: str) -> Resistance:
        return resistance(
            scene,
            lambda link: math.sqrt(link_friction(link)),
            lambda link: max(getattr(c, field) for c in link.colliders),
        )

    return {"torsional_friction": of("torsional_friction"), "rolling_friction": of("rolling_friction")}


def _object(tree: Tree, resistances: Mapping[str, Resistance], timestep: float) -> dict[str, object]:
    """One body of Bullet: an object, or a part of one that moves freely; keys that say nothing are left out."""
    item = tree.owner
    links = {link.name: _surface(item, link, resistances) for link in tree.links}
    moving = [joint for joint in tree.joints if joint.type is not JointType.FIXED]
    rest: dict[str, object] = {
        "links": links,
        "joint_friction": {joint.name: rounded(joint.friction) for joint in moving},
        "joint_damping": {joint.name: rounded(joint.damping) for joint in moving},
    }
    if len(item.links) > 1:
        rest |= {key: value for key, value in _joined(tree, moving, timestep).items() if value}
    return {"urdf": f"{tree.name}.urdf"} | meaning(item) | placement(tree) | rest


def _joined(tree: Tree, moving: Iterable[Joint], timestep: float) -> dict[str, object]:
    """How the links of a body move and touch each other."""
    item = tree.owner
    names, joints = {link.name for link in tree.links}, {joint.name for joint in tree.joints}
    touching = any(names.issuperset(pair) for pair in touching_pairs(item))
    silent = [list(pair) for pair in silent_pairs(item) if names.issuperset(pair)]
    drives = stable_drives(item, timestep, False)
    return {
        "balls": {j.name: _numbers(j.motion.q) for j in moving if j.type is JointType.BALL},
        "mimics": {j.name: _mimic(j.mimic) for j in moving if j.mimic is not None},
        "drives": {name: _drive(drive) for name, drive in drives.items() if name in joints},
        "self_collision": touching,
        "no_contact": silent if touching else [],
    }


def _surface(item: SceneObject, link: Link, resistances: Mapping[str, Resistance]) -> dict[str, float]:
    surface = {
        "lateral_friction": rounded(math.sqrt(link_friction(link))),
        "restitution": rounded(math.sqrt(link_restitution(link))),
    }
    for key, found in resistances.items():  # Bullet calls the first one spinning friction
        if value := found.written.get(item.qualified(link.name)):
            surface[key.replace("torsional", "spinning")] = rounded(value)
    return surface


def _mimic(mimic: Mimic) -> dict[str, object]:
    return {"joint": mimic.joint, "multiplier": rounded(mimic.multiplier), "offset": rounded(mimic.offset)}


def _drive(drive: Drive) -> dict[str, float]:
    found = {"stiffness": drive.stiffness, "damping": drive.damping, "target": drive.target}
    if drive.force_limit is not None:
        found["force_limit"] = drive.force_limit
    return {key: rounded(value) for key, value in found.items()}


def camera_arguments(camera: Camera) -> dict[str, object]:
    """Arguments of ``getCameraImage``; both matrices column by column, as OpenGL wants them."""
    flip = np.diag([1.0, -1.0, -1.0, 1.0])
    view = flip @ camera.X_WC.inverse().matrix
    return {
        "width": camera.width,
        "height": camera.height,
        "view": _numbers(view.T),
        "projection": _numbers(projection_matrix(camera).T),
    }


def lighting_arguments(lights: tuple[Light, ...]) -> dict[str, object]:
    """Arguments of ``getCameraImage``: the first light with a place or direction, and the sum of the domes; or none."""
    if not lights:
        return {}
    dome = math.fsum(t.intensity * float(np.mean(t.rgb)) for t in lights if t.type is LightType.DOME)
    lighting: dict[str, object] = {"lightAmbientCoeff": rounded(dome), "lightSpecularCoeff": 0.0}
    sun = _shining(lights)
    if sun is None:
        return lighting | {"lightDiffuseCoeff": 0.0}
    towards = sun.X_WL.rotation[:, 2] if sun.type is LightType.DISTANT else sun.X_WL.p
    color = {"lightDirection": _numbers(towards), "lightColor": _numbers(sun.rgb)}
    return lighting | color | {"lightDiffuseCoeff": rounded(sun.intensity)}


def _shining(lights: tuple[Light, ...]) -> Light | None:
    """The light of a picture: the first that is no dome."""
    return next((light for light in lights if light.type is not LightType.DOME), None)


def projection_matrix(camera: Camera) -> Array:
    """OpenGL's projection of a pinhole camera, shape (4, 4); the middle of the first pixel is (0, 0)."""
    left, right = -(camera.cx + 0.5) / camera.fx, (camera.width - camera.cx - 0.5) / camera.fx
    top, bottom = (camera.cy + 0.5) / camera.fy, -(camera.height - camera.cy - 0.5) / camera.fy
    return np.array(
        [
            [2 / (right - left), 0.0, (right + left) / (right - left), 0.0],
            [0.0, 2 / (top - bottom), (top + bottom) / (top - bottom), 0.0],
            [0.0, 0.0, -(FAR + NEAR) / (FAR - NEAR), -2 * FAR * NEAR / (FAR - NEAR)],
            [0.0, 0.0, -1.0, 0.0],
        ]
    )


def _numbers(values: Array) -> list[float]:
    return [rounded(v) for v in np.asarray(values).ravel().tolist()]


def _losses(scene: Scene, timestep: float, resistances: Mapping[str, Resistance]) -> Iterator[Loss]:
    if any(collider.friction > 0 for collider in _colliders(scene)):
        reason = "Bullet's friction depends on the direction: up to 9 % below Coulomb's between its two axes"
        yield Loss("friction", Fidelity.APPROXIMATED, reason)
    if any(collider.restitution > 0 for collider in _colliders(scene)):
        reason = "Bullet acts on an impact at whole steps: a rebound differs from the coefficient by up to 0.15"
        yield Loss("restitution", Fidelity.APPROXIMATED, reason)
    for key, found in resistances.items():
        if found.error > 1e-9:
            reason = f"Bullet mixes it with the sliding friction, one number a link: some pair is {found.error:.0%} off"
            yield Loss(key, Fidelity.APPROXIMATED, reason)
    for item in scene.objects:
        for link in item.links:
            yield from _surface_losses(item, link)
        if any(isinstance(collider.geometry, Mesh) for link in item.links for collider in link.colliders):
            reason = (
                "Bullet's skin rounds the edges of convex meshes by 1 mm, sharp tips by more, "
                "or thickens them where they are thinner"
            )
            yield Loss(f"{item.name}.colliders", Fidelity.APPROXIMATED, reason)
        yield from joint_losses(item)
    yield from stiffness_losses(scene, timestep, implicit_damping=False)
    sun = _shining(scene.lights)
    for light in scene.lights:
        if light.type is LightType.DOME:
            yield Loss(light.name, Fidelity.APPROXIMATED, _DOME)
        elif light is sun:
            yield Loss(light.name, Fidelity.APPROXIMATED, _SUN[light.type])
        else:
            yield Loss(light.name, Fidelity.DROPPED, "a picture of PyBullet has one light, and this is another")
    yield from splat_losses(scene, "PyBullet")
    yield from variant_losses(scene, "PyBullet")


def _colliders(scene: Scene) -> Iterator[Collider]:
    return (collider for item in scene.objects for link in item.links for collider in link.colliders)


def _surface_losses(item: SceneObject, link: Link) -> Iterator[Loss]:
    for field, value in (("friction", link_friction(link)), ("restitution", link_restitution(link))):
        values = sorted({getattr(collider, field) for collider in link.colliders})
        if len(values) > 1:
            span = ", ".join(number(v) for v in values)
            reason = f"Bullet has one {field} a link: {number(round(value, 4))} stands for {span}"
            yield Loss(f"{item.qualified(link.name)}.{field}", Fidelity.APPROXIMATED, reason)
