"""Conversion of sites, actuators and sensors to MJCF."""

from __future__ import annotations

import xml.etree.ElementTree as ET

from simfoundry.backends.artifact import exact, exacts
from simfoundry.backends.mjcf.attribute_values import attribute_texts, exact_pose, with_exact_values
from simfoundry.geometry.frames import Pose
from simfoundry.scene.attachments import Actuator, Sensor, Site
from simfoundry.scene.model import Scene, SceneObject

# The elements of MuJoCo's sensors, by type.
_SENSORS = {
    "joint_position": "jointpos",
    "joint_velocity": "jointvel",
    "position": "framepos",
    "orientation": "framequat",
    "linear_velocity": "framelinvel",
    "angular_velocity": "frameangvel",
}


def add_site(body: ET.Element, name: str, site: Site, X_BL: Pose) -> None:
    """Add a site to the body in whose frame its link has the pose ``X_BL``."""
    pose = with_exact_values(exact_pose(X_BL @ site.X_LS), site.mjcf)
    ET.SubElement(body, "site", {"name": name} | pose | attribute_texts(site.mjcf, "exact"))


def actuator_attributes(item: SceneObject, actuator: Actuator) -> dict[str, str]:
    """Return the attributes of an actuator."""
    out = {"name": f"{item.name}.{actuator.name}", "joint": f"{item.name}.{actuator.joint}"}
    if actuator.gear != 1:
        out["gear"] = exact(actuator.gear)
    if actuator.type == "position":
        out["kp"] = exact(actuator.kp)
    if actuator.kv:
        out["kv"] = exact(actuator.kv)
    for key, ends in (("ctrlrange", actuator.control_range), ("forcerange", actuator.force_range)):
        if ends is not None:
            out[key] = exacts(ends)
    return out | attribute_texts(actuator.mjcf)


def add_actuators(root: ET.Element, scene: Scene) -> list[float]:
    """Add the actuators of all objects, and return their initial controls."""
    found = [(item, actuator) for item in scene.objects for actuator in item.actuators]
    if found:
        parent = root.find("actuator")
        parent = ET.SubElement(root, "actuator") if parent is None else parent
        for item, actuator in found:
            ET.SubElement(parent, actuator.type, actuator_attributes(item, actuator))
    return [actuator.control for _, actuator in found]


def add_sensors(root: ET.Element, scene: Scene) -> None:
    """Add the sensors of all objects."""
    found = [(item, sensor) for item in scene.objects for sensor in item.sensors]
    if found:
        parent = ET.SubElement(root, "sensor")
        for item, sensor in found:
            ET.SubElement(parent, _SENSORS.get(sensor.type, sensor.type), _sensor_attributes(item, sensor))


def _sensor_attributes(item: SceneObject, sensor: Sensor) -> dict[str, str]:
    target = item.qualified(sensor.target) if sensor.place == "link" else f"{item.name}.{sensor.target}"
    is_frame = _SENSORS.get(sensor.type, "").startswith("frame")
    place = {"objtype": "xbody" if sensor.place == "link" else "site", "objname": target}
    out = {"name": f"{item.name}.{sensor.name}"} | (place if is_frame else {sensor.place: target})
    out |= {key: exact(value) for key, value in (("noise", sensor.noise), ("cutoff", sensor.cutoff)) if value}
    return out | attribute_texts(sensor.mjcf)
