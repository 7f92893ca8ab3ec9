"""Conversion of cameras, lights and metadata to MJCF."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from collections.abc import Iterator

import numpy as np

from simfoundry.backends.artifact import number, numbers
from simfoundry.backends.losses import Loss, approximate, drop
from simfoundry.backends.mjcf.contact_rules import ROBOTS
from simfoundry.backends.mjcf.skybox import skybox_light
from simfoundry.backends.robot_models.mujoco_robot import document_fields
from simfoundry.geometry.frames import IDENTITY, Array, Pose
from simfoundry.scene.model import Camera, JointType, Light, LightType, Scene, SceneObject
from simfoundry.scene.robot import mujoco_model

# A rotation by 180 degrees about x, between OpenCV axes (y down, z forward) and OpenGL axes (y up, z backward).
OPENCV_FROM_OPENGL = Pose.of(q=[0.0, 1.0, 0.0, 0.0])

# Offset [px] between a scene's pixel origin, the center of the first pixel, and MuJoCo's, the corner of the image.
_HALF_PIXEL = 0.5


def add_camera(world: ET.Element, camera: Camera) -> None:
    """Add a camera with exact intrinsics."""
    ET.SubElement(world, "camera", camera_attributes(camera))


def camera_attributes(camera: Camera, X_BW: Pose = IDENTITY) -> dict[str, str]:
    """Return the attributes of a camera in a body, where ``X_BW`` is the pose of the camera's parent frame.

    MuJoCo measures the principal point from the image center, to the left and up.
    """
    X_WG = X_BW @ camera.X_WC @ OPENCV_FROM_OPENGL
    principal = (camera.width / 2 - (camera.cx + _HALF_PIXEL), camera.height / 2 - (camera.cy + _HALF_PIXEL))
    attributes = {"name": camera.name, "pos": numbers(X_WG.p), "quat": numbers(X_WG.q)}
    # Any sensor with the image's aspect ratio would work; one micrometer per pixel keeps the numbers readable.
    sensor = {"sensorsize": numbers([camera.width * 1e-6, camera.height * 1e-6])}
    lens = {"focalpixel": numbers([camera.fx, camera.fy]), "principalpixel": numbers(principal)}
    return attributes | {"resolution": f"{camera.width} {camera.height}"} | sensor | lens


def add_lights(world: ET.Element, lights: tuple[Light, ...]) -> None:
    """Add the lights that have a position or a direction. They use only diffuse shading, without attenuation."""
    for light in lights:
        if light.type is LightType.DOME:
            continue
        direction = light.X_WL.rotation @ np.array([0.0, 0.0, -1.0])
        attributes = {"name": light.name, "pos": numbers(light.X_WL.p), "dir": numbers(direction)}
        attributes |= {"diffuse": numbers(light.intensity * light.rgb), "ambient": "0 0 0", "specular": "0 0 0"}
        if light.type is LightType.DISTANT:
            attributes["directional"] = "true"
        else:
            attributes |= {"cutoff": number(180), "exponent": "0", "attenuation": "1 0 0"}
        ET.SubElement(world, "light", attributes)


def headlight(lights: tuple[Light, ...]) -> dict[str, str] | None:
    """Return the attributes of MuJoCo's headlight, or None if the scene has no lights.

    The headlight represents the sum of all dome lights.
    """
    if not lights:
        return None
    domes: list[Array] = [light.intensity * light.rgb for light in lights if light.type is LightType.DOME]
    return {"ambient": numbers(sum(domes, np.zeros(3))), "diffuse": "0 0 0", "specular": "0 0 0"}


def light_losses(scene: Scene) -> Iterator[Loss]:
    """Yield one loss per dome light, and one per panorama."""
    reason = "MuJoCo has no dome lights; the light's color illuminates all surfaces equally, without shading."
    shown = skybox_light(scene.lights)
    for light in (light for light in scene.lights if light.type is LightType.DOME):
        yield approximate("dome_lights", light.name, reason)
        if light.panorama is not None and light is shown:
            clipped = "The panorama is shown as a skybox of 8-bit images, in which radiances above 1 are clipped."
            yield approximate("dome_textures", light.name, clipped)
        elif light.panorama is not None:
            first = "MuJoCo shows the first panorama in a format other than OpenEXR, which it cannot read."
            yield drop("dome_textures", light.name, first)


# The name of the custom text that marks a file as written by this backend; its data is the format version.
MARK = "simfoundry:scene"


def add_texts(root: ET.Element, scene: Scene) -> None:
    """Add a ``<custom>`` element.

    The element contains the categories, the labels, the stated relations, and names that MJCF cannot represent.
    """
    custom = ET.SubElement(root, "custom")
    _text(custom, MARK, "1")
    for item in scene.objects:
        if item.category:
            _text(custom, f"{item.name}.category", item.category)
        if item.labels:
            _text(custom, f"{item.name}.labels", " ".join(item.labels))
        _names(custom, item)
    if scene.relations:
        _text(custom, "relations", "; ".join(str(r) for r in scene.relations))
    _robots(custom, scene)
    for light in scene.lights:
        if light.type is LightType.DOME:
            _numeric(custom, f"{light.name}:dome", numbers(light.intensity * light.rgb))


def _names(custom: ET.Element, item: SceneObject) -> None:
    _text(custom, f"{item.name}:root", item.root.name)
    for joint in item.joints:
        child = item.qualified(joint.child)
        if joint.closed is not None:
            _text(custom, f"{item.name}.{joint.name}:closed", joint.closed)
        if joint.type is JointType.FIXED:
            _text(custom, f"{child}:joint", joint.name)
        elif joint.type is JointType.FREE:
            _text(custom, f"{child}:parent", joint.parent)
            _numeric(custom, f"{child}:zero", numbers([*joint.X_PC.p, *joint.X_PC.q]))


def _robots(custom: ET.Element, scene: Scene) -> None:
    written = [robot for robot in scene.robots if mujoco_model(robot)]
    if written:
        _text(custom, ROBOTS, " ".join(robot.name for robot in written))
    known = {robot.name: fields for robot in written if (fields := document_fields(robot))}
    for name, fields in known.items():
        _text(custom, f"{name}:robot", json.dumps(fields))
    for mounted in scene.mounted:
        if mounted.carrier in known and mounted.link:
            _text(custom, f"{mounted.camera.name}:mount", mounted.link)


def _text(custom: ET.Element, name: str, data: str) -> None:
    ET.SubElement(custom, "text", name=name, data=data)


def _numeric(custom: ET.Element, name: str, data: str) -> None:
    ET.SubElement(custom, "numeric", name=name, data=data)
