"""SceneSpec to Scene: every default resolved, every frame composed, every mass and convex part computed.

The same documents give the same scene on every machine. A finding in a mesh is reported at the line that names it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from simfoundry.assets.errors import MeshError
from simfoundry.geometry.frames import IDENTITY, Pose, look_at
from simfoundry.geometry.frames import frozen_array as frozen
from simfoundry.scene.bodies import BodyBuilder
from simfoundry.scene.model import (
    Background,
    Camera,
    Drive,
    Joint,
    JointType,
    LeftOut,
    Light,
    LightType,
    Link,
    Mimic,
    MountedCamera,
    Relation,
    Scene,
    SceneObject,
)
from simfoundry.scene.poses import pose as pose
from simfoundry.scene.source import Source
from simfoundry.spec.diagnostics import Diagnostic, SpecError
from simfoundry.spec.files import is_document
from simfoundry.spec.loaded import Loaded
from simfoundry.spec.models import base
from simfoundry.spec.models.asset import AssetSpec, DriveSpec, Inertial, JointSpec
from simfoundry.spec.models.data import to_data
from simfoundry.spec.models.expressions import parse_call
from simfoundry.spec.models.positions import Written, position
from simfoundry.spec.models.scene import DEFAULT_VARIANT, CameraSpec, LightSpec, ObjectSpec, SceneSpec
from simfoundry.spec.models.variants import variant_names, variant_of

if TYPE_CHECKING:
    from simfoundry.assets.cache import Cache
    from simfoundry.scene.robot import Robot
    from simfoundry.spec.models import scene as spec_scene

Progress = Callable[[str, int, int], None]


def lower(loaded: Loaded, cache: Cache | None = None, progress: Progress | None = None, fetch: bool = True) -> Scene:
    """Lower a checked scene document; raises :class:`SpecError` with every finding.

    ``cache`` keeps convex decompositions between runs; ``progress`` is called with a name, how many objects are done,
    and how many there are. Without ``fetch`` no robot's model is downloaded: one that is not here is left out.
    """
    if loaded.errors:
        raise SpecError(loaded.errors)
    assert isinstance(loaded.spec, SceneSpec)
    spec = loaded.spec
    objects = _objects(_Lowering(loaded, cache, progress, len(spec.objects)), spec)
    robots, no_models = _robots(loaded, spec, fetch)
    mounted = [_mounted(n, c, c.mount) for n, c in spec.cameras.items() if c.mount is not None]
    lowered, no_contact = _silenced(spec, (o for o in objects if o is not None))
    mounted, lost = _carried(mounted, {o.name: o for o in lowered}, {r.name for r in robots})
    return Scene(
        name=spec.name,
        gravity=frozen(spec.gravity, (3,)),
        objects=_placed(loaded, spec, lowered),
        cameras=tuple(camera(n, c) for n, c in spec.cameras.items() if c.mount is None),
        lights=tuple(_light(n, s) for n, s in spec.lights.items()),
        relations=tuple(_relation(text) for text in spec.relations),
        left_out=(*no_models, *lost, *_plain(loaded, spec)),
        robots=robots,
        mounted=tuple(mounted),
        background=None if spec.background is None else _background(loaded, spec.background),
        no_contact=no_contact,
        source=Source.of(_file_in_project(loaded), to_data(spec)),
        viewer=viewer(spec),
    )


def _objects(lowering: _Lowering, spec: SceneSpec) -> list[SceneObject | None]:
    """The objects as the spec has them, but for their places; raises :class:`SpecError` with every finding.

    What is to be inside of something, and all below it, comes first: whether it fits is known before the meshes of all
    other objects are cut into convex parts, which may take minutes. Where it does not, these are looked at uncut.
    """
    found: dict[str, SceneObject | None] = {}
    first = _below_what_is_inside(spec)
    misfits: list[Diagnostic] = []
    for name in (*first, *(name for name in spec.objects if name not in first)):
        lowering.report(name)
        found[name] = lowering.object(name, spec.objects[name], spec)
        lowering.done += 1
        if first and len(found) == len(first) and not lowering.findings:
            misfits = list(_misfits(lowering.loaded, spec, {k: item for k, item in found.items() if item is not None}))
            lowering.cuts = not misfits
    if lowering.findings or misfits:
        raise SpecError([*lowering.findings, *misfits])
    return [found[name] for name in spec.objects]


def _below_what_is_inside(spec: SceneSpec) -> tuple[str, ...]:
    """The objects with a place `inside` another and all that these places depend on, in the order of the spec."""
    from simfoundry.scene.place import needs

    places = {name: item.place for name, item in spec.objects.items() if item.place is not None}
    todo = [name for name, place in places.items() if place.inside is not None]
    seen = set[str]()
    while todo:
        name = todo.pop()
        if name not in seen:
            seen.add(name)
            todo += needs(places[name]) if name in places else ()
    return tuple(name for name in spec.objects if name in seen)


def _misfits(loaded: Loaded, spec: SceneSpec, objects: Mapping[str, SceneObject]) -> Iterator[Diagnostic]:
    """What is wrong with the places of some objects that depend on no others."""
    from simfoundry.scene.place import place_all

    places = {name: item.place for name, item in spec.objects.items() if item.place is not None and name in objects}
    for name, error in place_all(objects, places, viewer(spec))[1].items():
        yield loaded.finding("SF210", ("objects", name, "place"), error.message, error.hint)


def _background(loaded: Loaded, spec: spec_scene.BackgroundSpec) -> Background:
    from simfoundry.scene.background import lower_background

    return lower_background(loaded, spec, pose(spec.pose))


def _file_in_project(loaded: Loaded) -> str:
    """Where a document lies, counted from its project, so that it is the same on every machine."""
    path = loaded.path.resolve()
    return path.relative_to(loaded.root).as_posix() if path.is_relative_to(loaded.root) else path.name


def viewer(spec: SceneSpec) -> Pose | None:
    """The frame, x away and y left, in which left, right, front and behind are meant; None for that of the world.

    A robot sees along the x axis of its base, and so does a camera that it carries.
    """
    seen = spec.cameras.get(spec.viewpoint or "")
    if seen is not None and seen.mount is None:
        from simfoundry.scene.place import seen_by_camera

        return seen_by_camera(camera("", seen).X_WC)
    robot = spec.robots.get(spec.viewpoint or "" if seen is None else (seen.mount or "").partition(".")[0])
    return None if robot is None else pose(robot.pose)


def _placed(loaded: Loaded, spec: SceneSpec, objects: list[SceneObject]) -> tuple[SceneObject, ...]:
    """The objects with every `place` solved into a pose."""
    places = {name: item.place for name, item in spec.objects.items() if item.place is not None}
    if not places:
        return tuple(objects)
    from simfoundry.scene.place import place_all

    solved, errors = place_all({item.name: item for item in objects}, places, viewer(spec))
    for name, item in solved.items():
        if item.variants and name in places and not errors:
            # Each variant stands where it belongs, among all other things as they are.
            stood = [place_all(solved | {name: v}, {name: places[name]}, viewer(spec)) for v in item.variants]
            solved[name] = replace(item, variants=tuple(found[name] for found, _ in stood))
            errors |= {k: e for _, wrong in stood for k, e in wrong.items()}
    if errors:
        raise SpecError(
            loaded.finding("SF210", ("objects", name, "place"), e.message, e.hint) for name, e in errors.items()
        )
    return tuple(solved.values())


def _robots(loaded: Loaded, spec: SceneSpec, fetch: bool) -> tuple[tuple[Robot, ...], list[LeftOut]]:
    """The robots whose models are there, and what is left out with those that are not."""
    if not spec.robots:
        return (), []
    from simfoundry.scene.robot_packages import NoModelError
    from simfoundry.scene.robots import lower_robot

    found, lost = [], []
    for name, item in spec.robots.items():
        try:
            found.append(lower_robot(name, item, loaded.path, fetch))
        except NoModelError as error:
            lost.append(LeftOut(f"robots.{name}", f"no model found: {error}", pose(item.pose)))
            carried = [n for n, c in spec.cameras.items() if (c.mount or "").partition(".")[0] == name]
            lost += [LeftOut(f"cameras.{n}", f"it rides on `{name}`, of which no model is found") for n in carried]
    return tuple(found), lost


def _plain(loaded: Loaded, spec: SceneSpec) -> Iterator[LeftOut]:
    """The textures of objects that cannot be shown."""
    from simfoundry.assets.textures import document_faults

    for (_, name, _), fault in document_faults(loaded, spec):
        yield LeftOut(f"objects.{name}.texture", fault)
    for name, item in spec.objects.items():
        asset = loaded.used(item.asset) if item.asset is not None and is_document(item.asset) else None
        if asset is not None and isinstance(asset.spec, AssetSpec):
            for _, fault in document_faults(asset, asset.spec):
                yield LeftOut(f"objects.{name}.texture", fault)


def _carried(
    mounted: list[MountedCamera], objects: Mapping[str, SceneObject], robots: set[str]
) -> tuple[list[MountedCamera], list[LeftOut]]:
    """The cameras whose carrier is there, and those left out because the variant that stands lacks their link."""
    found, lost = [], []
    for one in mounted:
        item = objects.get(one.carrier)
        if item is not None and one.link and one.link not in {link.name for link in item.links}:
            reason = f"`{one.carrier}` stands as its variant `{item.variant}`, which has no link `{one.link}`"
            lost.append(LeftOut(f"cameras.{one.camera.name}", reason))
        elif item is not None or one.carrier in robots:
            found.append(one)
    return found, lost


def _mounted(name: str, spec: CameraSpec, mount: str) -> MountedCamera:
    carrier, _, link = mount.partition(".")
    return MountedCamera(carrier, link, camera(name, spec))


def _relation(text: str) -> Relation:
    call = parse_call(text)
    return Relation(call.predicate, call.args)


def camera(name: str, spec: CameraSpec) -> Camera:
    """A camera with its principal point and its pose resolved."""
    width, height = spec.size
    cx = (width - 1) / 2 if spec.cx is None else spec.cx
    cy = (height - 1) / 2 if spec.cy is None else spec.cy
    if spec.pose.look_at is not None:
        X_WC = look_at(np.array(spec.pose.xyz), np.array(spec.pose.look_at))
    else:
        X_WC = Pose.of(spec.pose.xyz, spec.pose.quat_wxyz or (1.0, 0.0, 0.0, 0.0))
    return Camera(name, width, height, spec.fx, spec.fy, cx, cy, X_WC)


def _light(name: str, spec: LightSpec) -> Light:
    """A light; it shines along -z of its frame."""
    X_WL = Pose.of(spec.xyz)
    if spec.type == "distant":
        aim = look_at(np.zeros(3), np.array(spec.direction)) @ Pose.of(q=(0.0, 1.0, 0.0, 0.0))
        X_WL = Pose.of(q=aim.q)
    return Light(name, LightType(spec.type), spec.intensity, frozen(spec.color[:3], (3,)), X_WL)


@dataclass
class _Lowering:
    """Lowers objects one by one and collects what is wrong with their meshes."""

    loaded: Loaded
    cache: Cache | None
    progress: Progress | None = None
    count: int = 0
    done: int = 0
    cuts: bool = True
    """Whether meshes are cut into convex parts; otherwise their hulls stand for them."""
    findings: list[Diagnostic] = field(default_factory=list)

    def report(self, said: str) -> None:
        """Say what is being done, and of how many objects how many are done."""
        if self.progress is not None:
            self.progress(said, self.done, self.count)

    def builder(
        self, owner: str, name: str, body: base.BodySpec, materials: dict[str, base.Material], weighed: bool
    ) -> BodyBuilder:
        """A builder of a link of the object ``owner``, which reports what takes long."""

        def report(said: str) -> None:
            self.report(f"{owner}: {said}")

        if not self.cuts and body.collision != "none":
            body = body.model_copy(update={"collision": "hull"})
        return BodyBuilder(name, body, materials, self.cache, weighed, report=report)

    def object(self, name: str, item: ObjectSpec, spec: SceneSpec) -> SceneObject | None:
        """The object as the chosen one of its variants, with the others beside it."""
        if not item.variants:
            return self.one(name, item, spec, ("objects", name))
        every = {}
        for key in variant_names(item):
            place = ("objects", name) if key == DEFAULT_VARIANT else ("objects", name, "variants", key)
            every[key] = self.one(name, variant_of(item, key), spec, place)
        chosen = every.pop(item.variant or DEFAULT_VARIANT)
        others = tuple(replace(o, variant=key) for key, o in every.items() if o is not None)
        return None if chosen is None else replace(chosen, variant=item.variant or DEFAULT_VARIANT, variants=others)

    def one(self, name: str, item: ObjectSpec, spec: SceneSpec, place: tuple[str, ...]) -> SceneObject | None:
        before = len(self.findings)
        category = item.category or name
        joints: tuple[Joint, ...] = ()
        silent: tuple[tuple[str, str], ...] = ()
        if item.asset is not None and is_document(item.asset):
            asset = self.loaded.used(item.asset)
            assert asset is not None and isinstance(asset.spec, AssetSpec)
            category = item.category or asset.spec.category or asset.spec.name
            links, joints = self.articulated(asset, asset.spec, item, name)
            silent = asset.spec.no_contact
        else:
            links = self.rigid(item, spec, place, name)
        if len(self.findings) > before:
            return None
        return SceneObject(name, category, item.fixed, pose(item.pose), tuple(links), joints, silent, item.labels)

    def rigid(self, item: ObjectSpec, spec: SceneSpec, place: tuple[str, ...], owner: str) -> list[Link]:
        """The one link of a primitive or of a mesh."""
        before = len(self.findings)
        builder = self.builder(owner, "base", item, spec.materials, False)
        with _At(self, self.loaded, (*place, "shape" if item.shape is not None else "asset")):
            if item.shape is not None:
                builder.add_shape("shape", item.shape, IDENTITY, None, show=item.visual is None)
            else:
                file, show = self.loaded.file(item.asset or ""), item.visual is None
                builder.add_mesh("mesh", file, item.scale, IDENTITY, None, show=show)
        if item.visual is not None:
            with _At(self, self.loaded, (*place, "visual")):
                builder.add_visual("visual", self.loaded.file(item.visual), item.scale)
        return self._built(builder, None, self.loaded, place, item.fixed, before)

    def articulated(
        self, asset: Loaded, spec: AssetSpec, item: ObjectSpec, owner: str
    ) -> tuple[list[Link], tuple[Joint, ...]]:
        """The links of an asset document in topological order, and its joints at the positions the object asks for."""
        links: list[Link] = []
        for name in _topological(spec):
            before = len(self.findings)
            link = spec.links[name]
            builder = self.builder(owner, name, link, spec.materials, link.weighed)
            for part_name, part in link.parts.items():
                with _At(self, asset, ("links", name, "parts", part_name)):
                    if part.shape is not None:
                        builder.add_shape(part_name, part.shape, pose(part.pose), part)
                    else:
                        builder.add_mesh(part_name, asset.file(part.mesh or ""), part.scale, pose(part.pose), part)
            links += self._built(builder, link.inertial, asset, ("links", name), False, before)
        return links, lower_joints(spec, item.joints)

    def _built(
        self, builder: BodyBuilder, inertial: Inertial | None, source: Loaded, place: tuple[str, ...], fixed: bool,
        before: int,
    ) -> list[Link]:  # fmt: skip
        """The finished link, alone in a list; empty where there are more findings than ``before`` it."""
        if len(self.findings) > before:
            return []
        with _At(self, source, place):
            return [builder.link(fixed, inertial)]
        return []


def _topological(spec: AssetSpec) -> Iterator[str]:
    """Links from the root outwards, siblings in the order of their joints."""
    todo = [next(iter(spec.links))]
    while todo:
        link = todo.pop(0)
        yield link
        todo += [j.child for j in spec.joints.values() if j.parent == link]


def lower_joints(spec: AssetSpec, given: Mapping[str, Written]) -> tuple[Joint, ...]:
    """The joints of an asset at the positions ``given``, by name; one that follows another is where that leads it."""
    return tuple(
        _joint(name, joint, position(spec, name, given), given.get(name)) for name, joint in spec.joints.items()
    )


def _joint(name: str, spec: JointSpec, position: float, written: Written | None) -> Joint:
    limits = spec.limits
    if spec.limits_deg is not None:
        limits = (math.radians(spec.limits_deg[0]), math.radians(spec.limits_deg[1]))
    axis = np.array(spec.axis) / np.linalg.norm(spec.axis) if any(spec.axis) else np.array([0.0, 0.0, 1.0])
    return Joint(
        name=name,
        type=JointType(spec.type),
        parent=spec.parent,
        child=spec.child,
        X_PC=pose(spec.pose),
        axis=frozen(axis, (3,)),
        limits=limits,
        damping=spec.damping,
        friction=spec.friction,
        armature=spec.armature,
        position=position,
        motion=pose(written) if isinstance(written, base.PoseSpec) else IDENTITY,
        mimic=None if spec.mimic is None else Mimic(spec.mimic.joint, spec.mimic.multiplier, spec.mimic.offset),
        drive=None if spec.drive is None else _drive(spec.drive, position),
        closed=spec.closed,
    )


def _drive(spec: DriveSpec, position: float) -> Drive:
    return Drive(spec.stiffness, spec.damping, position if spec.target is None else spec.target, spec.force_limit)


def _silenced(spec: SceneSpec, objects: Iterable[SceneObject]) -> tuple[list[SceneObject], tuple[tuple[str, str], ...]]:
    """The objects with the pairs of their own links that the scene keeps from touching, and its pairs between objects.

    Those between objects are of links by qualified name, each once.
    """
    by_name = {item.name: item for item in objects}

    def links(part: str) -> tuple[SceneObject, list[str]]:
        name, _, link = part.partition(".")
        item = by_name[name]
        carried = {joint.name: joint.child for joint in item.joints}
        return item, [carried.get(link, link)] if link else [k.name for k in item.links]

    between: dict[tuple[str, str], None] = {}
    for (a, links_a), (b, links_b) in ((links(a), links(b)) for a, b in spec.no_contact):
        if a.name == b.name:
            own = (*a.no_contact, *((one, other) for one, other in product(links_a, links_b) if one != other))
            by_name[a.name] = replace(a, no_contact=own)
            continue
        for one, other in product(links_a, links_b):
            first, second = sorted((a.qualified(one), b.qualified(other)))
            between[first, second] = None
    return list(by_name.values()), tuple(between)


@dataclass
class _At:
    """Turns a :class:`MeshError` inside it into a finding at a place of a document."""

    lowering: _Lowering
    source: Loaded
    path: tuple[str, ...]

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: Any) -> bool:
        if not isinstance(error, MeshError):
            return False
        self.lowering.findings.append(self.source.finding(error.code, self.path, str(error), error.hint))
        return True


def lower_file(path: Path, cache: Cache | None = None, progress: Progress | None = None, fetch: bool = True) -> Scene:
    """Load, check and lower the scene document at ``path``, as :func:`lower` does; raises :class:`SpecError`."""
    from simfoundry.spec.load import load_scene

    return lower(load_scene(path), cache, progress, fetch)
