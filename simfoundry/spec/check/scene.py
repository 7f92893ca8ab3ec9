"""Check scenes: materials, assets, joints, places, robots, cameras, and relations."""

from __future__ import annotations

from pydantic import ValidationError

from simfoundry.errors import SimfoundryError
from simfoundry.spec.check.checker import Checker, Path_
from simfoundry.spec.check.joints import check_joints, check_pair
from simfoundry.spec.check.names import SceneNames
from simfoundry.spec.check.plausible import volume
from simfoundry.spec.files import ASSET_SUFFIX, MESH_SUFFIXES, is_document, packaged_model
from simfoundry.spec.models.base import WORLD, BodySpec
from simfoundry.spec.models.robot import RobotFiles, RobotSpec
from simfoundry.spec.models.scene import DEFAULT_VARIANT, ObjectSpec, SceneSpec
from simfoundry.spec.models.variants import variant_of

OF_LINKS = ("scale", "visual", *BodySpec.model_fields)
"""Fields of an object that have no effect if its asset document defines them for its links."""

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
    c.densities(spec.materials)
    objects = spec.objects.values()
    c.unused(spec.materials, {o.material for o in (*objects, *(v for item in objects for v in item.variants.values()))})
    for name, robot in spec.robots.items():
        _robot(c, robot, ("robots", name))
    names = SceneNames(c.loaded, spec)
    _names(c, names, spec)
    places = {name: item.place for name, item in spec.objects.items() if item.place is not None}
    for name, place in places.items():
        names.check_place(c, name, place, ("objects", name, "place"))
    if places:
        names.check_order(c, places, {name: ("objects", name, "place") for name in places})
    for name, camera in spec.cameras.items():
        if camera.mount is not None:
            _mount(c, names, camera.mount, ("cameras", name, "mount"))
    if spec.viewpoint is not None:
        c.name(spec.viewpoint, [*c.names("cameras"), *names.robots], ("viewpoint",), "camera or robot")
    if spec.background is not None:
        for key, suffixes in (("mesh", MESH_SUFFIXES), ("splat", (".ply",))):
            file: str | None = getattr(spec.background, key)
            if file is not None:
                c.file(file, ("background", key), suffixes)
    seen: set[frozenset[str]] = set()
    for k, pair in enumerate(spec.no_contact):
        for i, part in enumerate(pair):
            names.check_part(c, part, ("no_contact", k, i))
        check_pair(c, pair, k, seen)
    _relations(c, names, spec)


def _names(c: Checker, names: SceneNames, spec: SceneSpec) -> None:
    """Check that each name in the scene is unambiguous, both in the scene and in every output format."""
    for section, what in (("objects", names.objects), ("robots", names.robots)):
        if WORLD in what:
            c.reserved((section, WORLD), section.removesuffix("s"))
    for name in names.robots:
        if name in names.objects:
            message = f"an object and a robot are called `{name}`, so references to it are ambiguous"
            c.add("SF213", ("robots", name), message, "rename one of them")
    if spec.viewpoint in names.robots and spec.viewpoint in c.names("cameras"):
        message = f"a camera and a robot are called `{spec.viewpoint}`, so left and right are ambiguous"
        c.add("SF213", ("viewpoint",), message, "rename one of them")


def _object(c: Checker, name: str, item: ObjectSpec, spec: SceneSpec, path: Path_) -> None:
    c.material(item, path)
    if item.visual is not None:
        c.file(item.visual, (*path, "visual"), MESH_SUFFIXES)
    if item.asset is not None:
        _asset(c, item, item.asset, path)
    elif item.joints:
        c.add("SF201", (*path, "joints"), f"`{name}` is a primitive and has no joints")
    if item.asset is None or not is_document(item.asset):
        if not item.fixed:
            c.mass(item, [item.material], spec.materials, path)
        if item.mass is not None or item.density is not None:
            c.density(item, path, volume(item.shape) if item.shape is not None else None)


def _variants(c: Checker, name: str, item: ObjectSpec, spec: SceneSpec) -> None:
    """Check each variant as a separate object; errors of the base object are reported only once."""
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
            c.add("SF201", (*path, "joints"), "a mesh has no joints; describe it in an `.asset.yaml`")
        return
    for field in OF_LINKS:
        if getattr(item, field) != ObjectSpec.model_fields[field].default:
            message = f"`{field}` has no effect here: the links of `{reference}` have their own"
            c.add("SF107", (*path, field), message, "write it in that document")
    used = c.use(reference, place, ("asset/1",), (ASSET_SUFFIX,))
    if used is None:
        return
    from simfoundry.spec.models.asset import AssetSpec

    if isinstance(used.spec, AssetSpec):
        check_joints(c, used.spec, item.joints, (*path, "joints"))


def _robot(c: Checker, robot: RobotSpec, path: Path_) -> None:
    if isinstance(robot.model, RobotFiles):
        for key, suffixes in ROBOT_SUFFIXES.items():
            file: str | None = getattr(robot.model, key)
            if file is not None and packaged_model(file) is None and c.file(file, (*path, "model", key), suffixes):
                _robot_file(c, key, file, (*path, "model", key))
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


def _robot_file(c: Checker, key: str, reference: str, path: Path_) -> None:
    """Check a robot file without opening its models."""
    if key == "file":
        from simfoundry.spec.models.robot_file import read_robot_file

        file = c.loaded.file(reference)
        try:
            read_robot_file(file)
        except SimfoundryError as error:
            c.add("SF107", path, str(error).replace(str(file), reference))


def _mount(c: Checker, names: SceneNames, mount: str, path: Path_) -> None:
    carrier, _, link = mount.partition(".")
    if carrier not in names.robots:
        if c.name(carrier, [*names.robots, *names.objects], path, "robot or object"):
            names.check_part(c, mount, path)
        return
    robot = names.spec.robots.get(carrier) if names.spec is not None else None
    known = robot.known() if robot is not None else None
    if link and known is not None:
        c.name(link, known.links, path, f"link of `{carrier}`")


def _relations(c: Checker, names: SceneNames, spec: SceneSpec) -> None:
    """Check the relations in the text, including faulty ones."""
    written = c.document.data.get("relations") if spec.relations else ()
    for k, text in enumerate(written if isinstance(written, tuple) else ()):
        if isinstance(text, str):
            names.check_call(c, text, ("relations", k))
