"""Check scenes: materials, assets, joints, robots, cameras, and the names in places and conditions."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from pydantic import ValidationError

from simfoundry.errors import SimfoundryError
from simfoundry.spec.check.asset import check_joints, check_pairs
from simfoundry.spec.check.cameras import check_mount, check_target
from simfoundry.spec.check.checker import Checker, Path_, piece_clash, volume
from simfoundry.spec.check.frames import check_frames
from simfoundry.spec.check.names import SceneNames, asset_in
from simfoundry.spec.check.outliers import check_scene_outliers
from simfoundry.spec.check.plausible import check_camera, check_friction, check_gravity, check_size
from simfoundry.spec.files import (
    ASSET_SUFFIX,
    MESH_SUFFIXES,
    PANORAMA_SUFFIXES,
    SPLAT_SUFFIXES,
    is_document,
    packaged_model,
)
from simfoundry.spec.models.base import WORLD, BodySpec
from simfoundry.spec.models.reuse import FramedPose
from simfoundry.spec.models.robot import RobotFiles, RobotSpec
from simfoundry.spec.models.scene import (
    DEFAULT_VARIANT,
    GeometrySpec,
    ObjectSpec,
    Place,
    SceneSpec,
    variant_of,
)
from simfoundry.spec.models.shapes import shape_parts

if TYPE_CHECKING:
    pass

# Fields that have no effect on an object whose asset is a document, because the document defines them per link.
OF_LINKS = ("scale", "visual", *BodySpec.model_fields)

ROBOT_SUFFIXES = {
    "file": (".yaml", ".yml"),
    "mjcf": (".xml", ".mjcf"),
    "urdf": (".urdf",),
    "usd": (".usd", ".usda", ".usdc", ".usdz"),
}


def check_scene(c: Checker, spec: SceneSpec) -> None:
    """Check a scene."""
    for name, item in spec.objects.items():
        _object(c, name, item, spec, ("objects", name))
        _variants(c, name, item, spec)
    c.materials(spec.materials)
    objects = spec.objects.values()
    c.unused(spec.materials, {name for o in objects for item in (o, *o.variants.values()) for name in _materials(item)})
    for name, robot in spec.robots.items():
        _robot(c, robot, ("robots", name))
    names = SceneNames(c.loaded, spec)
    _names(c, names, spec)
    places: dict[str, Place | FramedPose] = {n: o.place or o.pose for n, o in spec.objects.items()}
    keys = {name: "pose" if isinstance(place, FramedPose) else "place" for name, place in places.items()}
    names.check_places(c, places, {name: ("objects", name, key) for name, key in keys.items()})
    check_frames(c, names, spec)
    check_gravity(c, spec.gravity)
    check_scene_outliers(c, spec)
    for name, camera in spec.cameras.items():
        check_camera(c, camera, ("cameras", name))
        if camera.mount is not None:
            check_mount(c, names, camera.mount, ("cameras", name, "mount"))
        if isinstance(camera.pose.look_at, str):
            check_target(c, names, camera.pose.look_at, camera.mount, ("cameras", name, "pose", "look_at"))
    for name, light in spec.lights.items():
        c.file(light.texture, ("lights", name, "texture"), PANORAMA_SUFFIXES)
    if spec.viewpoint is not None:
        c.name(spec.viewpoint, [*c.names("cameras"), *names.robots], ("viewpoint",), "camera or robot")
    if spec.background is not None:
        c.file(spec.background.mesh, ("background", "mesh"), MESH_SUFFIXES)
        c.file(spec.background.splat, ("background", "splat"), SPLAT_SUFFIXES)
    check_pairs(c, spec.no_contact, partial(names.check_part, c))
    _relations(c, names, spec)


def _names(c: Checker, names: SceneNames, spec: SceneSpec) -> None:
    """Check that each name in the scene is unambiguous, both in the scene and in every output format."""
    for section, what in (("objects", names.objects), ("robots", names.robots)):
        if WORLD in what:
            c.reserved((section, WORLD), section.removesuffix("s"))
    for name in names.robots:
        if name in names.objects:
            message = f"an object and a robot are both called `{name}`, so references to it are ambiguous"
            c.add("SF213", ("robots", name), message, "rename one of them")
    if spec.viewpoint in names.robots and spec.viewpoint in c.names("cameras"):
        message = f"a camera and a robot are both called `{spec.viewpoint}`, so left and right are ambiguous"
        c.add("SF213", ("viewpoint",), message, "rename one of them")


def _materials(item: GeometrySpec) -> list[str | None]:
    """Return the materials that an object or a variant names for itself and for the parts of its shape."""
    parts = shape_parts(item.shape).values() if item.shape is not None else ()
    return [item.material, *(part.material for part in parts)]


def _object(c: Checker, name: str, item: ObjectSpec, spec: SceneSpec, path: Path_) -> None:
    c.material(item, path)
    parts = shape_parts(item.shape) if item.shape is not None else {}
    for part_name, part in parts.items():
        c.material(part, (*path, "shape", "compound", part_name))
    if (clash := piece_clash({key: part.shape for key, part in parts.items()})) is not None:
        message = f"a piece of the part `{clash[0]}` is also called `{clash[1]}`"
        c.add("SF213", (*path, "shape", "compound", clash[1]), message, "rename one of the parts")
    check_friction(c, item, path)
    if item.shape is not None:
        check_size(c, item.shape, (*path, "shape"), item.fixed)
    c.file(item.visual, (*path, "visual"), MESH_SUFFIXES)
    if item.asset is not None:
        _asset(c, item, item.asset, path)
    elif item.joints:
        c.add("SF201", (*path, "joints"), f"`{name}` is a primitive, so it cannot have joints")
    if item.asset is None or not is_document(item.asset):
        if not item.fixed:
            made_of = [part.material or item.material for part in parts.values()] or [item.material]
            c.mass(item, made_of, spec.materials, path)
        if item.mass is not None or item.density is not None:
            c.density(item, path, volume(item.shape) if item.shape is not None else None)


def _variants(c: Checker, name: str, item: ObjectSpec, spec: SceneSpec) -> None:
    """Check each variant as a separate object. Errors of the base object are reported only once."""
    if item.variant is not None and item.variant != DEFAULT_VARIANT:
        c.name(item.variant, item.variants, ("objects", name, "variant"), f"variant of `{name}`")
    said = {(d.code, d.message) for d in c.findings}
    for key in item.variants:
        path = ("objects", name, "variants", key)
        try:
            whole = variant_of(item, key)
        except ValidationError as error:
            for wrong in error.errors(include_url=False):
                c.add("SF107", path, wrong["msg"])
            continue
        before = len(c.findings)
        _object(c, name, whole, spec, path)
        c.findings[before:] = [d for d in c.findings[before:] if (d.code, d.message) not in said]


def _asset(c: Checker, item: ObjectSpec, reference: str, path: Path_) -> None:
    place = (*path, "asset")
    if not is_document(reference):
        c.file(reference, place, (*MESH_SUFFIXES, ASSET_SUFFIX))
        if item.joints:
            c.add("SF201", (*path, "joints"), "a mesh cannot have joints; describe the object in an `.asset.yaml` file")
        return
    for field in OF_LINKS:
        if getattr(item, field) != ObjectSpec.model_fields[field].default:
            message = f"`{field}` has no effect here: each link in `{reference}` defines its own"
            c.add("SF107", (*path, field), message, "set it in that document")
    used = c.use(reference, place, ("asset/1",), (ASSET_SUFFIX,))
    asset = asset_in(used)
    if asset is not None:
        check_joints(c, asset, item.joints, (*path, "joints"))


def _robot(c: Checker, robot: RobotSpec, path: Path_) -> None:
    if isinstance(robot.model, RobotFiles):
        for key, suffixes in ROBOT_SUFFIXES.items():
            file: str | None = getattr(robot.model, key)
            if file is None or packaged_model(file) is not None:
                continue
            if c.file(file, (*path, "model", key), suffixes) and key == "file":
                _robot_file(c, file, (*path, "model", key))
        return
    from simfoundry.spec.models.robot_file import find_robot, robot_names

    try:
        known = find_robot(robot.model)
    except SimfoundryError as error:
        c.add("SF107", (*path, "model"), str(error))
        return
    if known is None:
        c.name(robot.model, robot_names(), (*path, "model"), "robot")
    elif isinstance(robot.joints, dict):
        for joint in robot.joints:
            c.name(joint, known.home, (*path, "joints", joint), f"joint of `{robot.model}`")


def _robot_file(c: Checker, reference: str, path: Path_) -> None:
    """Check a robot file without opening its models."""
    from simfoundry.spec.models.robot_file import read_robot_file

    file = c.loaded.file(reference)
    try:
        read_robot_file(file)
    except SimfoundryError as error:
        c.add("SF107", path, str(error).replace(str(file), reference))


def _relations(c: Checker, names: SceneNames, spec: SceneSpec) -> None:
    """Check the relations as written, including invalid ones."""
    written = c.document.data.get("relations") if spec.relations else ()
    for k, text in enumerate(written if isinstance(written, tuple) else ()):
        if isinstance(text, str):
            names.check_call(c, text, ("relations", k))
