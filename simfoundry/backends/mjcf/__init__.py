"""MJCF for MuJoCo: ``scene.xml``, the pairs of its contacts, its assets and a loader.

Names: a body is its object, or ``object.link`` where it is not the root; a free root's joint is its object, any other
``object.joint``; collision geoms are ``object.collider`` (``object.link.collider``), visual geoms ``object:visual``,
and those of the background ``:background:visual``. A primitive that is both is one geom, named as a collider. Visuals
are in group 2, all other colliders in group 3, which cameras leave out. Meshes are named after the first geom that
uses them: ``bowl_collision_3``.

Each material is a class; see :mod:`simfoundry.backends.mjcf.contact_rules` for how unlike materials meet. Mass
properties are explicit. Links that a joint connects do not collide: joints, not contacts, hold a drawer in its cabinet.

The initial state is the keyframe ``initial``. Free bodies also stand there without it; joints stand at zero. ``ref``
would let them start elsewhere, but ball joints have none, some readers count joint coordinates from it (Newton takes
``qpos - ref``), and an edit of a position by hand would have to change a body's pose, a ``ref`` and the keyframe alike.

A robot is its own MJCF below a body of its name; its names have the robot's before them: ``arm.joint1``. Its frames
that a scene can name are sites: ``arm.hand``.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

from simfoundry.backends.artifact import Artifact, number, numbers
from simfoundry.backends.backend import Backend
from simfoundry.backends.losses import Loss, splat_losses, variant_losses
from simfoundry.backends.mjcf.bodies import add_background, add_object
from simfoundry.backends.mjcf.contact_rules import CONTACTS_FILE, contacts_text
from simfoundry.backends.mjcf.contacts import (
    COLLISION,
    VISUAL,
    VISUAL_GROUP,
    MaterialClasses,
    contact_geoms,
    contact_losses,
    excluded_pairs,
    excluded_set,
    resists_rolling,
)
from simfoundry.backends.mjcf.custom import add_texts
from simfoundry.backends.mjcf.cylinders import prism_losses, with_prisms
from simfoundry.backends.mjcf.features import FEATURES, restitution_losses
from simfoundry.backends.mjcf.meshes import Assets
from simfoundry.backends.mjcf.motors import add_drives, add_mimics
from simfoundry.backends.mjcf.robots import add_mounted_cameras, add_robot, robot_losses
from simfoundry.backends.mjcf.surroundings import add_camera, add_lights, headlight, light_losses
from simfoundry.backends.names import InvalidSceneError, check_names
from simfoundry.backends.robot_models.robot_urdf import without_model
from simfoundry.backends.stable_drives import stiffness_losses
from simfoundry.backends.xmltext import xml_text
from simfoundry.runtime.shipped import shipped
from simfoundry.scene.model import Scene

TIMESTEP = 1 / 500
"""Seconds per step: MuJoCo's default, at which its contacts of 20 ms are stable."""

EXACT, NATIVE = "exact", "native"
"""The contacts that a build can have: what two surfaces mean together, or what MuJoCo's own rule makes of them."""

_LOADER = shipped("targets/mjcf") / "load.py"
_RULES = Path(__file__).parent / "contact_rules.py"


def compile_mjcf(
    scene: Scene, timestep: float = TIMESTEP, cylinder_sides: float = 0.0, contacts: str = EXACT
) -> Artifact:
    """Compile a scene to MJCF that steps by ``timestep`` [s].

    With ``cylinder_sides`` of three or more, cylinders collide as prisms of so many sides, for readers that collide no
    cylinders. ``contacts`` is `exact` or `native`; native leaves out the pairs: MuJoCo then takes the larger friction
    of two surfaces. Raises :class:`InvalidSceneError` for unusable names and for other contacts.
    """
    if contacts not in (EXACT, NATIVE):
        raise InvalidSceneError(f"the option `contacts` is `{EXACT}` or `{NATIVE}`, not `{contacts}`")
    check_names(scene)
    sides = int(cylinder_sides)
    losses = list(prism_losses(scene, sides)) if sides >= 3 else []
    scene = with_prisms(scene, sides) if sides >= 3 else scene
    materials = MaterialClasses(scene)
    root = ET.Element("mujoco", model=scene.name)
    _add_settings(root, scene, timestep, materials)
    assets = Assets(ET.SubElement(root, "asset"))
    world = ET.SubElement(root, "worldbody")
    add_lights(world, scene.lights)
    for camera in scene.cameras:
        add_camera(world, camera)
    if scene.background is not None:
        add_background(world, scene.background, assets)
    qpos: list[float] = []
    for item in scene.objects:
        qpos.extend(add_object(world, item, assets, materials))
    excluded = excluded_pairs(scene)
    _add_exclusions(root, excluded)
    add_mimics(root, scene)
    ctrl = add_drives(root, scene, timestep)
    add_texts(root, scene)
    for robot in scene.robots:
        read = add_robot(root, robot, assets, timestep)
        if read is None:
            losses.append(without_model(robot.name))
            continue
        qpos.extend(read.qpos)
        ctrl.extend(read.ctrl)
        losses.extend(robot_losses(robot, read, timestep))
    add_mounted_cameras(world, scene)
    _add_keyframe(root, qpos, ctrl)
    files = {"load.py": _LOADER.read_bytes()}
    geoms = contact_geoms(scene)
    if contacts == EXACT:
        root.append(ET.Comment("The frictions of unlike materials that meet: generated, see there."))
        ET.SubElement(root, "include", file=CONTACTS_FILE)
        files[CONTACTS_FILE] = contacts_text(geoms, excluded_set(excluded)).encode()
    files |= {"scene.xml": xml_text(root), _RULES.name: _RULES.read_bytes()}
    files |= {f"assets/{name}": data for name, data in assets.files.items()}
    return Artifact(
        "mjcf", "scene.xml", files, (*losses, *contact_losses(geoms, contacts == EXACT), *_losses(scene, timestep))
    )


def _losses(scene: Scene, timestep: float) -> list[Loss]:
    return [
        *restitution_losses(scene),
        *stiffness_losses(scene, timestep, implicit_damping=True),
        *light_losses(scene),
        *variant_losses(scene, "MJCF"),
        *splat_losses(scene, "MuJoCo"),
    ]


def _add_settings(root: ET.Element, scene: Scene, timestep: float, materials: MaterialClasses) -> None:
    """Add how to read the file, how to step, and what the geoms have in common."""
    root.append(ET.Comment(f"{scene.name}: generated by SimFoundry. `python load.py` opens it in its initial state."))
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
    root.append(ET.Comment("Masses and inertias are explicit: nothing is derived from geoms."))
    ET.SubElement(root, "compiler", compiler)
    # An elliptic cone with a stiff tangent keeps Coulomb's law: a box holds on a slope up to the angle of friction.
    option = {"timestep": number(timestep), "gravity": numbers(scene.gravity), "integrator": "implicitfast"}
    # Resistance against rolling is so small beside it that the tangent has to be stiffer still, or a held ball creeps.
    impratio = "100" if resists_rolling(scene) else "10"
    root.append(ET.Comment("The elliptic cone and impratio keep Coulomb's law: friction holds up to its angle."))
    ET.SubElement(root, "option", option | {"cone": "elliptic", "impratio": impratio})
    visual = ET.SubElement(root, "visual")
    cameras = [*scene.cameras, *(m.camera for m in scene.mounted)]
    if cameras:  # the off-screen buffer must hold the largest picture
        width, height = max(c.width for c in cameras), max(c.height for c in cameras)
        ET.SubElement(visual, "global", offwidth=str(width), offheight=str(height))
    if (own_light := headlight(scene.lights)) is not None:
        ET.SubElement(visual, "headlight", own_light)
    root.append(ET.Comment("A class for each material: its friction, and its restitution as `user` and damping."))
    default = ET.SubElement(root, "default")
    # Stiff, so that Coulomb friction holds a joint still; at MuJoCo's default a held drawer creeps 10 mm/s.
    ET.SubElement(default, "joint", solimpfriction="0.999 0.999 0.001 0.5 2")
    visuals = ET.SubElement(default, "default", {"class": VISUAL})
    ET.SubElement(visuals, "geom", group=VISUAL_GROUP, contype="0", conaffinity="0", mass="0")
    colliders = ET.SubElement(default, "default", {"class": COLLISION})
    # MuJoCo takes the larger resistance of a pair, so where one counts, the defaults of all others must not.
    ET.SubElement(colliders, "geom", group="3", condim="3", friction="1 0 0", rgba="0.9 0.5 0.2 0.5")
    materials.add_defaults(colliders)


def _add_exclusions(root: ET.Element, excluded: list[tuple[str, str]]) -> None:
    """Add the pairs of bodies that do not collide."""
    if excluded:
        root.append(ET.Comment("Bodies that pass through each other: joints, not contacts, hold them together."))
        contact = ET.SubElement(root, "contact")
        for a, b in excluded:
            ET.SubElement(contact, "exclude", body1=a, body2=b)


def _add_keyframe(root: ET.Element, qpos: list[float], ctrl: list[float]) -> None:
    """Add the initial state of all joints and actuators."""
    root.append(ET.Comment("The initial state: without it, joints stand at zero."))
    state = {name: numbers(values) for name, values in (("qpos", qpos), ("ctrl", ctrl)) if values}
    ET.SubElement(ET.SubElement(root, "keyframe"), "key", {"name": "initial"} | state)


BACKEND = Backend(compile_mjcf, FEATURES)
