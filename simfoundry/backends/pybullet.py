"""PyBullet: the URDFs of the urdf backend, ``world.json`` with what URDF lacks, and a loader.

Bullet multiplies the frictions and restitutions of two bodies; each link therefore has the square root of its own, and
a pair the geometric mean of both. A link has one friction, however many colliders it has. Bullet puts a skin around
convex meshes that no setting removes; they are written smaller by that much, so that their faces are where they belong.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from simfoundry.backends.artifact import Artifact, Fidelity, Loss, number
from simfoundry.backends.inset import inset_hull
from simfoundry.backends.names import check_names
from simfoundry.backends.robot_urdf import RobotUrdf, Write, robot_urdf
from simfoundry.backends.urdf import Dialect, Parts, joint_losses, placement, urdf_files, whole
from simfoundry.scene.frames import Array, Pose
from simfoundry.scene.model import Camera, Collider, Geometry, JointType, Link, Mesh, Scene, SceneObject

TIMESTEP = 1 / 500
"""Seconds a step."""

NEAR, FAR = 0.01, 100.0
"""Clipping distances of the cameras [m]."""

SKIN = 1e-3
"""Thickness of the skin around a convex mesh that is loaded from URDF [m]."""

_LOADER = Path(__file__).parent / "templates" / "pybullet_load.py"


def compile_pybullet(scene: Scene) -> Artifact:
    """Compile a scene for PyBullet. Raises :class:`InvalidSceneError` for unusable names."""
    check_names(scene)
    dialect = Dialect(shown=whole, felt=_under_skin())
    files = urdf_files(scene, dialect)
    robots, lost = bullet_robots(scene, lambda item: urdf_files(replace(scene, objects=(item,)), dialect))
    for robot in robots.values():
        files.update(robot.files)
    world: dict[str, object] = {
        "gravity": _numbers(scene.gravity),
        "timestep": TIMESTEP,
        "objects": {item.name: _object(item) for item in scene.objects},
        "cameras": {camera.name: _camera(camera) for camera in scene.cameras},
    }
    if robots:
        world["robots"] = {name: _robot(robot) for name, robot in robots.items()}
    files["world.json"] = (json.dumps(world, indent=2) + "\n").encode()
    files["load.py"] = _LOADER.read_bytes()
    return Artifact("pybullet", "load.py", files, (*_losses(scene), *lost))


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
        reason = "its surfaces are as its file has them, and Bullet multiplies them with the roots of the scene's"
        losses.append(Loss(f"{robot.name}.friction", Fidelity.APPROXIMATED, reason))
    for mounted in scene.mounted:
        reason = f"it rides on `{mounted.carrier}`, and cameras in the files of PyBullet stand still"
        losses.append(Loss(mounted.camera.name, Fidelity.DROPPED, reason))
    return robots, losses


def _robot(robot: RobotUrdf) -> dict[str, object]:
    """A robot in ``world.json``: where it stands, what its motors hold, and which joints follow others."""
    motors = {
        name: {"target": _number(position), "force": _number(robot.efforts[name])}
        for name, position in robot.positions.items()
        if name in robot.efforts and name not in robot.follow
    }
    follow = {
        name: {"joint": leader.joint, "multiplier": _number(leader.multiplier), "offset": _number(leader.offset)}
        for name, leader in robot.follow.items()
    }
    item = robot.item
    links = _object(item)["links"] if item is not None else {}
    return {
        "urdf": robot.path,
        "p": _numbers(robot.X_WB.p),
        "q_wxyz": _numbers(robot.X_WB.q),
        "joints": {name: _number(position) for name, position in robot.positions.items()},
        "motors": motors,
        "follow": follow,
        "links": links,
        "arm": dict(robot.joints),
        "gripper": {name: [_number(v) for v in pair] for name, pair in robot.gripper.items()},
        "frames": {
            name: {"link": frame.link, "p": _numbers(frame.X_LF.p), "q_wxyz": _numbers(frame.X_LF.q)}
            for name, frame in robot.frames.items()
        },
    }


def link_friction(link: Link) -> float:
    """The one coefficient that stands for all colliders of a link: their geometric mean."""
    return _geometric_mean([collider.friction for collider in link.colliders])


def link_restitution(link: Link) -> float:
    """The one restitution that stands for all colliders of a link: their geometric mean."""
    return _geometric_mean([collider.restitution for collider in link.colliders])


def _geometric_mean(values: list[float]) -> float:
    if not values or min(values) <= 0:
        return 0.0
    return values[0] if len(set(values)) == 1 else math.exp(sum(map(math.log, values)) / len(values))


def _under_skin() -> Parts:
    """A split that gives each mesh as Bullet's skin will restore it; one too thin for that stays as it is."""
    done: dict[str, Mesh] = {}

    def parts(geometry: Geometry) -> Iterator[tuple[str, Geometry, Pose]]:
        if isinstance(geometry, Mesh):
            digest = geometry.digest
            if digest not in done:
                done[digest] = inset_hull(geometry, SKIN) or geometry
            geometry = done[digest]
        yield "", geometry, Pose.of()

    return parts


def _object(item: SceneObject) -> dict[str, object]:
    links = {
        link.name: {
            "lateral_friction": _number(math.sqrt(link_friction(link))),
            "restitution": _number(math.sqrt(link_restitution(link))),
        }
        for link in item.links
    }
    friction = {joint.name: _number(joint.friction) for joint in item.joints if joint.type is not JointType.FIXED}
    damping = {joint.name: _number(joint.damping) for joint in item.joints if joint.type is not JointType.FIXED}
    rest = {"links": links, "joint_friction": friction, "joint_damping": damping}
    return {"urdf": f"{item.name}.urdf", "category": item.category} | placement(item) | rest


def _camera(camera: Camera) -> dict[str, object]:
    """Arguments of ``getCameraImage``; both matrices column by column, as OpenGL wants them."""
    flip = np.diag([1.0, -1.0, -1.0, 1.0])
    view = flip @ camera.X_WC.inverse().matrix
    return {
        "width": camera.width,
        "height": camera.height,
        "view": _numbers(view.T),
        "projection": _numbers(projection_matrix(camera).T),
    }


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


def _number(value: float) -> float:
    return float(number(value))


def _numbers(values: Array) -> list[float]:
    return [_number(v) for v in np.asarray(values).ravel()]


def _losses(scene: Scene) -> Iterator[Loss]:
    if any(collider.friction > 0 for collider in _colliders(scene)):
        reason = "Bullet's friction depends on the direction: up to 9 % below Coulomb's between its two axes"
        yield Loss("friction", Fidelity.APPROXIMATED, reason)
    if any(collider.restitution > 0 for collider in _colliders(scene)):
        reason = "Bullet acts on an impact at whole steps: a rebound differs from the coefficient by up to 0.15"
        yield Loss("restitution", Fidelity.APPROXIMATED, reason)
    for item in scene.objects:
        for link in item.links:
            yield from _surface_losses(item, link)
        if any(isinstance(collider.geometry, Mesh) for link in item.links for collider in link.colliders):
            reason = "Bullet's skin rounds the edges of convex meshes by 1 mm, or thickens them where they are thinner"
            yield Loss(f"{item.name}.colliders", Fidelity.APPROXIMATED, reason)
        yield from joint_losses(item)
    for light in scene.lights:
        reason = "a PyBullet world holds no lights: each picture brings its own"
        yield Loss(light.name, Fidelity.DROPPED, reason)


def _colliders(scene: Scene) -> Iterator[Collider]:
    return (collider for item in scene.objects for link in item.links for collider in link.colliders)


def _surface_losses(item: SceneObject, link: Link) -> Iterator[Loss]:
    for field, value in (("friction", link_friction(link)), ("restitution", link_restitution(link))):
        values = sorted({getattr(collider, field) for collider in link.colliders})
        if len(values) > 1:
            span = ", ".join(number(v) for v in values)
            reason = f"Bullet has one {field} a link: {number(round(value, 4))} stands for {span}"
            yield Loss(f"{item.qualified(link.name)}.{field}", Fidelity.APPROXIMATED, reason)
