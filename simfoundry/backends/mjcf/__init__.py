"""MJCF for MuJoCo: ``scene.xml``, its assets and a loader.

Names: a body is its object, or ``object.link`` where it is not the root; a free root's joint is its object, any other
``object.joint``; collision geoms are ``object.collider`` (``object.link.collider``), what a camera sees
``object:visual``, and what is around it all ``:background:visual``. Visuals are in group 2 and touch nothing, colliders
in group 3, which cameras leave out.

Mass properties are explicit. MuJoCo takes the larger friction of two geoms and averages the stiffness; where the scene
means something else, :mod:`simfoundry.backends.mjcf.contacts` makes it right. Bodies ``table:touch4`` are a part of
that. Links that a joint connects do not touch: joints, not contacts, hold a drawer in its cabinet.

A robot is its own MJCF below a body of its name; its names have the robot's before them: ``arm.joint1``. Its frames
that a scene can name are sites: ``arm.hand``.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET

from simfoundry.backends.artifact import Artifact, number, numbers
from simfoundry.backends.backend import Backend
from simfoundry.backends.losses import Loss, splat_losses, variant_losses
from simfoundry.backends.mjcf.bodies import add_background, add_object
from simfoundry.backends.mjcf.contacts import add_contacts, contacts_of
from simfoundry.backends.mjcf.custom import add_texts
from simfoundry.backends.mjcf.cylinders import prism_losses, with_prisms
from simfoundry.backends.mjcf.features import FEATURES
from simfoundry.backends.mjcf.foreign_geoms import guests_of
from simfoundry.backends.mjcf.meshes import Assets
from simfoundry.backends.mjcf.motors import add_drives, add_mimics
from simfoundry.backends.mjcf.restitution import restitution_losses
from simfoundry.backends.mjcf.robots import add_mounted_cameras, add_robot, robot_losses
from simfoundry.backends.mjcf.surfaces import resists
from simfoundry.backends.mjcf.surroundings import add_camera, add_lights, headlight, light_losses
from simfoundry.backends.names import check_names
from simfoundry.backends.robot_models.robot_urdf import without_model
from simfoundry.backends.stable_drives import stiffness_losses
from simfoundry.backends.xmltext import xml_text
from simfoundry.runtime.shipped import shipped
from simfoundry.scene.model import Scene

TIMESTEP = 1 / 500
"""Seconds a step."""

_LOADER = shipped("targets/mjcf") / "load.py"


def compile_mjcf(scene: Scene, timestep: float = TIMESTEP, cylinder_sides: float = 0.0) -> Artifact:
    """Compile a scene to MJCF that steps by ``timestep`` [s].

    With ``cylinder_sides`` of three or more, cylinders collide as prisms of so many sides, for readers that collide no
    cylinders. Raises :class:`InvalidSceneError` for unusable names.
    """
    check_names(scene)
    sides = int(cylinder_sides)
    rounded = tuple(prism_losses(scene, sides)) if sides >= 3 else ()
    scene = with_prisms(scene, sides) if sides >= 3 else scene
    root = ET.Element("mujoco", model=scene.name)
    _add_settings(root, scene, timestep)
    assets = Assets(ET.SubElement(root, "asset"))
    world = ET.SubElement(root, "worldbody")
    add_lights(world, scene.lights)
    for camera in scene.cameras:
        add_camera(world, camera)
    if scene.background is not None:
        add_background(world, scene.background, assets)
    qpos: list[float] = []
    contacts = contacts_of(scene, guests_of(scene))
    for item in scene.objects:
        qpos.extend(add_object(world, item, assets, contacts))
    add_contacts(root, scene, contacts)
    add_mimics(root, scene)
    ctrl = add_drives(root, scene, timestep)
    add_texts(root, scene, contacts)
    lost: list[Loss] = []
    for robot in scene.robots:
        read = add_robot(root, robot, assets, timestep)
        if read is None:
            lost.append(without_model(robot.name))
            continue
        qpos.extend(read.qpos)
        ctrl.extend(read.ctrl)
        lost.extend(robot_losses(robot, read, timestep))
    add_mounted_cameras(world, scene)
    keyframe = ET.SubElement(root, "keyframe")
    state = {name: numbers(values) for name, values in (("qpos", qpos), ("ctrl", ctrl)) if values}
    ET.SubElement(keyframe, "key", {"name": "initial"} | state)
    files = {"scene.xml": xml_text(root), "load.py": _LOADER.read_bytes()}
    files |= {f"assets/{name}": data for name, data in assets.files.items()}
    losses = (
        *restitution_losses(scene),
        *stiffness_losses(scene, timestep, implicit_damping=True),
        *light_losses(scene),
        *lost,
        *variant_losses(scene, "MJCF"),
        *splat_losses(scene, "MuJoCo"),
        *rounded,
    )
    return Artifact("mjcf", "scene.xml", files, losses)


def _add_settings(root: ET.Element, scene: Scene, timestep: float) -> None:
    """How to read the file, how to step, and what the geoms have in common."""
    compiler = {
        "angle": "radian",
        "meshdir": "assets",
        "texturedir": "assets",
        "autolimits": "true",
        "inertiafromgeom": "false",
        "balanceinertia": "false",
        "boundmass": "0",
        "boundinertia": "0",
        "fusestatic": "false",
        "discardvisual": "false",
    }
    ET.SubElement(root, "compiler", compiler)
    # An elliptic cone with a stiff tangent keeps Coulomb's law: a box holds on a slope up to the angle of friction.
    option = {"timestep": number(timestep), "gravity": numbers(scene.gravity), "integrator": "implicitfast"}
    # Resistance against rolling is so small beside it that the tangent has to be stiffer still, or a held ball creeps.
    ET.SubElement(root, "option", option | {"cone": "elliptic", "impratio": "100" if resists(scene) else "10"})
    visual = ET.SubElement(root, "visual")
    cameras = [*scene.cameras, *(m.camera for m in scene.mounted)]
    if cameras:  # the off-screen buffer must hold the largest picture
        width, height = max(c.width for c in cameras), max(c.height for c in cameras)
        ET.SubElement(visual, "global", offwidth=str(width), offheight=str(height))
    if (own_light := headlight(scene.lights)) is not None:
        ET.SubElement(visual, "headlight", own_light)
    default = ET.SubElement(root, "default")
    # Stiff, so that Coulomb friction holds a joint still; at MuJoCo's default a held drawer creeps 10 mm/s.
    ET.SubElement(default, "joint", solimpfriction="0.999 0.999 0.001 0.5 2")
    seen = ET.SubElement(default, "default", {"class": "visual"})
    ET.SubElement(seen, "geom", group="2", contype="0", conaffinity="0", mass="0")
    felt = ET.SubElement(default, "default", {"class": "collider"})
    ET.SubElement(felt, "geom", group="3", condim="3", rgba="0.9 0.5 0.2 0.5")


BACKEND = Backend(compile_mjcf, FEATURES)
