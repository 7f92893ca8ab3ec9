"""The MJCF backend for MuJoCo, which writes ``scene.xml`` with its contact pairs, assets and loader.

Naming: the body of a root link is named after the object, and any other body is named ``object.link``. The free joint
of a root is named after the object, and any other joint is named ``object.joint``. Collision geoms are named
``object.collider`` or ``object.link.collider``. Visual geoms are named ``object:visual``, or ``:background:visual`` in
the background. A primitive that is both visual and collider becomes one geom with the collider's name. Visual geoms are
in group 2. Colliders that are not visual are in group 3, which cameras do not render. A mesh is named after the first
geom that uses it, for example ``bowl_collision_3``.

Settings shared by all scenes are in ``settings.xml``. Each material becomes a default class;
:mod:`simfoundry.backends.mjcf.contact_rules` describes contacts between unlike materials. Mass properties are explicit.
Links connected by a joint do not collide: for example, a joint rather than contacts keeps a drawer in its cabinet.

The initial state is stored in the ``initial`` keyframe. Without this keyframe, free bodies are at their initial poses,
but joints are at zero. A keyframe must also contain the poses of free bodies; the loader and the importer use the poses
of the bodies instead, so that manual changes to them take effect. The ``ref`` attribute could also specify an initial
joint position, but it has three drawbacks: ball joints do not support it, some readers measure joint coordinates
relative to it (Newton uses ``qpos - ref``), and anyone editing a position by hand would have to change the body pose,
``ref`` and the keyframe together.

A robot keeps its own MJCF model, placed below a body named after the robot. All names in the model are prefixed with
the robot's name, as in ``arm.joint1``. The robot frames that a scene can refer to become sites, such as ``arm.hand``.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from simfoundry.backends.artifact import Artifact, Backend, exact, exacts, numbers
from simfoundry.backends.convex_hulls import REPLACED, hull_losses, with_hulls
from simfoundry.backends.features import read_cells
from simfoundry.backends.losses import Loss, splat_losses, unused_native_losses, variant_losses
from simfoundry.backends.mjcf import contacts as scene_contacts
from simfoundry.backends.mjcf.attachments import add_actuators, add_sensors
from simfoundry.backends.mjcf.bodies import Assets, add_background, add_drives, add_mimics, add_object, joint_losses
from simfoundry.backends.mjcf.contact_rules import CONTACTS_FILE, contacts_text
from simfoundry.backends.mjcf.cylinders import prism_losses, with_prisms
from simfoundry.backends.mjcf.native import NativeWriter, check_references
from simfoundry.backends.mjcf.robots import add_mounted_cameras, add_robot, robot_losses
from simfoundry.backends.mjcf.skybox import add_skybox, skybox_light
from simfoundry.backends.mjcf.surroundings import add_camera, add_lights, add_texts, headlight, light_losses
from simfoundry.backends.names import InvalidSceneError, check_names, check_timestep
from simfoundry.backends.robot_models.robot_object import without_model
from simfoundry.backends.stable_drives import stiffness_losses
from simfoundry.backends.xmltext import xml_text
from simfoundry.geometry.shapes import Ellipsoid
from simfoundry.runtime.files import shipped
from simfoundry.scene.model import Scene

# Time step [s]. This is MuJoCo's default, at which contacts with its time constant of 20 ms are stable.
TIMESTEP = 1 / 500

# The contact modes of a build: exact pairwise friction as in the scene, or MuJoCo's native rule.
EXACT, NATIVE = "exact", "native"

_LOADER = shipped("targets/mjcf") / "load.py"
_RULES = Path(__file__).with_name("contact_rules.py")

# The settings that are the same for all scenes. The elliptic cone with stiff tangential constraints preserves Coulomb's
# law: a box stays at rest on any slope below the friction angle. `solimpfriction` is stiff enough for Coulomb friction
# to keep a joint at rest; with MuJoCo's default, a joint held by friction creeps at 10 mm/s. MuJoCo uses the larger
# resistance of a pair, so the default resistances of collision geoms are zero.
_SETTINGS = Path(__file__).with_name("settings.xml")


@contextmanager
def naming_scene(name: str) -> Iterator[None]:
    """Convert MuJoCo's errors about the MJCF of a scene to :class:`InvalidSceneError`s that name the scene."""
    try:
        yield
    except ValueError as error:
        said = "; ".join(str(error).strip().splitlines()).removeprefix("Error: ")
        raise InvalidSceneError(f"MuJoCo cannot load scene `{name}`: {said}") from error


def compile_mjcf(
    scene: Scene, timestep: float = TIMESTEP, cylinder_sides: float = 0.0, contacts: str = EXACT
) -> Artifact:
    """Compile a scene to MJCF.

    Args:
        scene: The lowered scene.
        timestep: The simulation time step [s].
        cylinder_sides: If this whole number is not zero, cylinders collide as prisms with this many sides (at least
            three), and ellipsoids as hulls, for readers that do not support their collisions.
        contacts: `exact` to write contact pairs, or `native` to omit them, in which case MuJoCo uses the larger of the
            two friction coefficients.

    Raises:
        InvalidSceneError: If a name or an option is invalid.
    """
    _check_options(timestep, cylinder_sides, contacts)
    check_names(scene)
    sides = int(cylinder_sides)
    hulled = (*REPLACED["mjcf"], *([Ellipsoid] if sides >= 3 else []))
    losses = [*hull_losses(scene, hulled), *(prism_losses(scene, sides) if sides >= 3 else ())]
    scene = with_hulls(scene, hulled)
    scene = with_prisms(scene, sides) if sides >= 3 else scene
    if timestep == TIMESTEP and scene.options.timestep is not None:
        timestep = scene.options.timestep
    if scene.native is not None:
        return _compile_native(scene, timestep, losses)
    materials = scene_contacts.MaterialClasses(scene)
    root = _settings(scene, timestep, materials)
    assets = Assets(ET.SubElement(root, "asset"))
    world = ET.SubElement(root, "worldbody")
    _add_surroundings(world, scene, assets)
    qpos: list[float] = []
    for item in scene.objects:
        qpos.extend(add_object(world, item, assets, materials))
    excluded = scene_contacts.excluded_pairs(scene)
    _add_exclusions(root, excluded)
    add_mimics(root, scene)
    ctrl = add_drives(root, scene, timestep) + add_actuators(root, scene)
    add_sensors(root, scene)
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
    geoms = scene_contacts.contact_geoms(scene)
    if contacts == EXACT:
        root.append(ET.Comment("Generated frictions for contacts between different materials; see the comments there."))
        ET.SubElement(root, "include", file=CONTACTS_FILE)
        files[CONTACTS_FILE] = contacts_text(geoms, frozenset(map(frozenset, excluded))).encode()
    files |= {"scene.xml": xml_text(root), _RULES.name: _RULES.read_bytes()}
    files |= {f"assets/{name}": data for name, data in assets.files.items()}
    losses += [
        *scene_contacts.contact_losses(geoms, contacts == EXACT),
        *stiffness_losses(scene, timestep, implicit_damping=True),
        *joint_losses(scene),
        *unused_native_losses(scene),
        *_common_losses(scene),
    ]
    return Artifact("mjcf", "scene.xml", files, tuple(losses))


def _add_surroundings(world: ET.Element, scene: Scene, assets: Assets) -> None:
    """Add the lights, the cameras that are fixed in the world, and the background."""
    add_lights(world, scene.lights)
    if (sky := skybox_light(scene.lights)) is not None:
        assets.files |= add_skybox(assets.element, sky)
    for camera in scene.cameras:
        add_camera(world, camera)
    if scene.background is not None:
        add_background(world, scene.background, assets)


def _add_exclusions(root: ET.Element, pairs: Sequence[tuple[str, str]]) -> None:
    """Add the pairs of bodies that do not collide."""
    if pairs:
        root.append(ET.Comment("Pairs of bodies that do not collide, usually because they are connected by a joint."))
        contact = ET.SubElement(root, "contact")
        for a, b in pairs:
            ET.SubElement(contact, "exclude", body1=a, body2=b)


def _common_losses(scene: Scene) -> Iterator[Loss]:
    """Yield the losses that do not depend on how the scene is written."""
    yield from scene_contacts.restitution_losses(scene)
    yield from light_losses(scene)
    yield from variant_losses(scene, "MJCF")
    yield from splat_losses(scene, "MuJoCo")


def _compile_native(scene: Scene, timestep: float, losses: list[Loss]) -> Artifact:
    """Compile a scene with native data, for which MuJoCo's own rules apply."""
    root = _settings(scene, timestep, None)
    assets = Assets(ET.SubElement(root, "asset"))
    world = ET.SubElement(root, "worldbody")
    _add_surroundings(world, scene, assets)
    writer = NativeWriter(scene, root, world, assets)
    writer.settings()
    qpos, ctrl = writer.write()
    for robot in scene.robots:
        read = add_robot(root, robot, assets, timestep)
        if read is None:
            losses.append(without_model(robot.name))
            continue
        qpos.extend(read.qpos)
        ctrl.extend(read.ctrl)
        losses.extend(robot_losses(robot, read, timestep))
    robots = {robot.name for robot in scene.robots}
    add_mounted_cameras(world, replace(scene, mounted=tuple(m for m in scene.mounted if m.carrier in robots)))
    check_references(root)
    writer.keyframes(qpos, ctrl)
    files = {"load.py": _LOADER.read_bytes(), "scene.xml": xml_text(root), _RULES.name: _RULES.read_bytes()}
    files |= {f"assets/{name}": data for name, data in assets.files.items()}
    losses += [*scene_contacts.contact_losses(scene_contacts.contact_geoms(scene), False), *_common_losses(scene)]
    return Artifact("mjcf", "scene.xml", files, tuple(losses))


def _check_options(timestep: float, cylinder_sides: float, contacts: str) -> None:
    """Raise :class:`InvalidSceneError` if an option of :func:`compile_mjcf` is invalid."""
    check_timestep(timestep)
    if contacts not in (EXACT, NATIVE):
        raise InvalidSceneError(f"option `contacts` must be `{EXACT}` or `{NATIVE}`, not `{contacts}`")
    if cylinder_sides and (cylinder_sides < 3 or cylinder_sides % 1):
        message = f"option `cylinder_sides` must be a whole number of at least 3, or 0, not `{cylinder_sides:g}`"
        raise InvalidSceneError(message)


def _settings(scene: Scene, timestep: float, materials: scene_contacts.MaterialClasses | None) -> ET.Element:
    """Return the root of an MJCF file that contains compiler settings, solver settings and default classes.

    Without ``materials``, MuJoCo's own defaults apply to everything except visual geoms.
    """
    comments = ET.XMLParser(target=ET.TreeBuilder(insert_comments=True))
    root = ET.fromstring(_SETTINGS.read_text(encoding="utf-8").replace("SCENE", scene.name), comments)
    settings = {element.tag: element for element in root}
    option = {"timestep": exact(timestep), "gravity": exacts(scene.gravity)}
    # Rolling resistance is small compared with friction, so it requires even stiffer tangential constraints; otherwise,
    # a ball at rest creeps.
    option["impratio"] = "100" if scene_contacts.resists_rolling(scene) else "10"
    settings["option"].attrib.update(option)
    cameras = [*scene.cameras, *(m.camera for m in scene.mounted)]
    if cameras:  # the off-screen buffer must hold the largest image
        width, height = max(c.width for c in cameras), max(c.height for c in cameras)
        ET.SubElement(settings["visual"], "global", offwidth=str(width), offheight=str(height))
    if (own_light := headlight(scene.lights)) is not None:
        ET.SubElement(settings["visual"], "headlight", own_light)
    if materials is not None:
        materials.add_defaults(settings["default"][-1])
    else:
        defaults = settings["default"]
        defaults[:] = [each for each in defaults if each.get("class") == scene_contacts.VISUAL]
    return root


def _add_keyframe(root: ET.Element, qpos: list[float], ctrl: list[float]) -> None:
    """Add the initial state of all joints and actuators as a keyframe."""
    root.append(ET.Comment("The initial state. Without this keyframe, all joints start at zero."))
    root.append(ET.Comment("load.py places free bodies at the pose of their body element instead of the pose here."))
    state = {name: numbers(values) for name, values in (("qpos", qpos), ("ctrl", ctrl)) if values}
    ET.SubElement(ET.SubElement(root, "keyframe"), "key", {"name": "initial"} | state)


BACKEND = Backend(compile_mjcf, read_cells(Path(__file__).parent))
