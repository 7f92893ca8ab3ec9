"""Lower the objects in a scene document, including their links, masses, colliders and joints."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from simfoundry.assets.cache import Cache
from simfoundry.assets.errors import MeshError
from simfoundry.assets.textures import read_texture
from simfoundry.geometry.frames import IDENTITY
from simfoundry.geometry.frames import frozen_array as frozen
from simfoundry.geometry.shapes import Mesh
from simfoundry.scene.attachments import Actuator, NativeAttributes, Sensor, Site
from simfoundry.scene.bodies import BodyBuilder
from simfoundry.scene.box_mapping import Texture
from simfoundry.scene.model import Drive, Joint, JointType, Link, Mimic, SceneObject
from simfoundry.scene.state import pose
from simfoundry.spec.diagnostics import Diagnostic
from simfoundry.spec.files import Loaded, is_document
from simfoundry.spec.models import base, scene
from simfoundry.spec.models.asset import AssetSpec, Inertial
from simfoundry.spec.models.joint import JointSpec

if TYPE_CHECKING:
    from simfoundry.scene.bodies import MeshUse
    from simfoundry.scene.mesh_bodies import MeshBody

# Callback that receives a name, the number of finished objects, and the total number of objects.
Progress = Callable[[str, int, int], None]


@dataclass
class ObjectLowering:
    """A pass that lowers the objects in a document and collects findings about their meshes.

    Unless ``cuts`` is set, meshes are represented by their convex hulls instead of being decomposed into convex parts.
    In a ``draft``, meshes also have no visuals, unless it is ``shown`` (see
    :class:`~simfoundry.scene.bodies.BodyBuilder`). ``approximate`` contains the names of objects that are represented
    only by their bounds.
    """

    loaded: Loaded
    cache: Cache | None = None
    progress: Progress | None = None
    done: int = 0
    draft: bool = False
    cuts: bool = True
    shown: bool = False
    findings: list[Diagnostic] = field(default_factory=list)
    approximate: set[str] = field(default_factory=set)
    _textures: dict[Path, bytes | None] = field(default_factory=dict)
    _drafts: dict[tuple[Path, MeshUse], MeshBody] = field(default_factory=dict)
    _drafted_links: dict[Path, tuple[list[Link], bool]] = field(default_factory=dict)

    @property
    def _spec(self) -> scene.SceneSpec:
        assert isinstance(self.loaded.spec, scene.SceneSpec)
        return self.loaded.spec

    def report(self, step: str) -> None:
        """Report the current step, along with the number of finished objects and the total number of objects."""
        if self.progress is not None:
            self.progress(step, self.done, len(self._spec.objects))

    @contextmanager
    def _reporting(self, source: Loaded, path: tuple[str, ...]) -> Iterator[None]:
        """Convert a :class:`MeshError` raised in the block to a finding at a location in a document."""
        try:
            yield
        except MeshError as error:
            self.findings.append(source.finding(error.code, path, str(error), error.hint))

    def _builder(
        self,
        owner: str,
        name: str,
        body: base.BodySpec,
        source: Loaded,
        materials: dict[str, base.Material],
        weighed: bool,
    ) -> BodyBuilder:
        """Return a builder for a link of the ``owner`` object, whose materials are in the document ``source``.

        The builder reports slow steps.
        """
        if not self.cuts and body.collision != "none":
            body = body.model_copy(update={"collision": "hull"})
        builder = BodyBuilder(name, body, materials, self.cache, weighed, self.draft, self.shown, drafts=self._drafts)
        builder.texture_of = lambda material: self._texture(source, material, materials[material])
        for material in materials if self.draft else ():  # a draft shows no meshes, but reports unusable textures
            self._texture(source, material, materials[material])
        builder.report = lambda step: self.report(f"{owner}: {step}")
        return builder

    def _texture(self, source: Loaded, name: str, material: base.Material) -> Texture | None:
        """Return the texture of a material, which is read only once, or None if it has none or cannot be read."""
        if material.texture is None:
            return None
        path = source.file(material.texture)
        if path not in self._textures:
            self._textures[path] = None
            with self._reporting(source, ("materials", name, "texture")):
                self._textures[path] = read_texture(path)
        png = self._textures[path]
        return None if png is None else Texture(png, material.texture_size)

    def lower(self, name: str) -> SceneObject | None:
        """Return the selected variant of the object, with the other variants attached."""
        item = self._spec.objects[name]
        if not item.variants:
            return self._one(name, item, ("objects", name))
        every, selected = {}, item.variant or scene.DEFAULT_VARIANT
        for key in scene.variant_names(item):
            place = ("objects", name) if key == scene.DEFAULT_VARIANT else ("objects", name, "variants", key)
            every[key] = self._one(name, scene.variant_of(item, key), place)
        chosen = every.pop(selected)
        others = tuple(replace(o, variant=key) for key, o in every.items() if o is not None)
        return None if chosen is None else replace(chosen, variant=selected, variants=others)

    def _one(self, name: str, item: scene.ObjectSpec, place: tuple[str, ...]) -> SceneObject | None:
        before = len(self.findings)
        reuse = self.loaded.reuse  # a copy has the category of the object that is repeated
        category = item.category or (reuse.base_name(name) if reuse is not None else name)
        joints: tuple[Joint, ...] = ()
        no_contact: tuple[tuple[str, str], ...] = ()
        attached: dict[str, Any] = {"native": inline_native(item)}
        if item.asset is not None and is_document(item.asset):
            asset = self.loaded.used(item.asset)
            assert asset is not None and isinstance(asset.spec, AssetSpec)
            category = item.category or asset.spec.category or asset.spec.name
            attached = attachments(asset.spec)
            links, joints = self.articulated(asset, asset.spec, item, name, attached["native"].meshes)
            no_contact = asset.spec.no_contact
        else:
            links = self._rigid(item, place, name)
        if len(self.findings) > before:
            return None
        return SceneObject(
            name, category, item.fixed, pose(item.pose), tuple(links), joints, no_contact, item.labels, **attached
        )

    def _rigid(self, item: scene.ObjectSpec, place: tuple[str, ...], owner: str) -> list[Link]:
        """Return a list with the single link of a primitive or mesh object."""
        before, show = len(self.findings), item.visual is None
        builder = self._builder(owner, "base", item, self.loaded, self._spec.materials, False)
        with self._reporting(self.loaded, (*place, "shape" if item.shape is not None else "asset")):
            if item.shape is not None:
                builder.add_shape("shape", item.shape, IDENTITY, None, show)
            else:
                builder.add_mesh("mesh", self.loaded.file(item.asset or ""), item.scale, IDENTITY, None, show)
        if item.visual is not None:
            with self._reporting(self.loaded, (*place, "visual")):
                builder.add_visual("visual", self.loaded.file(item.visual), item.scale)
        return self._built(builder, None, self.loaded, place, item.fixed, before, owner)

    def articulated(
        self, asset: Loaded, spec: AssetSpec, item: scene.ObjectSpec, owner: str,
        hidden: dict[tuple[str, str], Mesh] | None = None,
    ) -> tuple[list[Link], tuple[Joint, ...]]:  # fmt: skip
        """Return an asset's links in topological order, and its joints at the positions set by the object.

        The whole meshes of parts with native data that are not shown are added to ``hidden``.
        """
        joints = lower_joints(spec, item.joints)
        if not self.draft:
            return self._links(asset, spec, owner, hidden), joints
        before = len(self.findings)
        if asset.path not in self._drafted_links:  # objects with the same asset share the links of a draft
            links = self._links(asset, spec, owner, hidden)
            if len(self.findings) > before:
                return links, joints
            self._drafted_links[asset.path] = links, owner in self.approximate
        links, is_approximate = self._drafted_links[asset.path]
        if is_approximate:
            self.approximate.add(owner)
        return links, joints

    def _links(
        self, asset: Loaded, spec: AssetSpec, owner: str, hidden: dict[tuple[str, str], Mesh] | None
    ) -> list[Link]:
        """Return the links of an asset in topological order; see :meth:`articulated`."""
        links: list[Link] = []
        for name in _topological(spec):
            before = len(self.findings)
            link = spec.links[name]
            builder = self._builder(owner, name, link, asset, spec.materials, link.weighed)
            for part_name, part in link.parts.items():
                with self._reporting(asset, ("links", name, "parts", part_name)):
                    if part.shape is not None:
                        builder.add_shape(part_name, part.shape, pose(part.pose), part)
                    else:
                        builder.add_mesh(part_name, asset.file(part.mesh or ""), part.scale, pose(part.pose), part)
            if hidden is not None:
                hidden |= {(name, part_name): mesh for part_name, mesh in builder.hidden.items()}
            built = self._built(builder, link.inertial, asset, ("links", name), False, before, owner)
            links += [replace(each, gravity_compensation=link.gravity_compensation) for each in built]
        return links

    def _built(
        self, builder: BodyBuilder, inertial: Inertial | None, source: Loaded, place: tuple[str, ...], fixed: bool,
        before: int, owner: str,
    ) -> list[Link]:  # fmt: skip
        """Return a list with the finished link, or an empty list if there are more findings than ``before``."""
        if builder.is_approximate:
            self.approximate.add(owner)
        if len(self.findings) > before:
            return []
        with self._reporting(source, place):
            return [builder.link(fixed, inertial)]
        return []


def _topological(spec: AssetSpec) -> Iterator[str]:
    """Yield the links from the root outward. Siblings are in the order of their joints."""
    todo = [next(iter(spec.links))]
    while todo:
        link = todo.pop(0)
        yield link
        todo += [j.child for j in spec.joints.values() if j.parent == link]


def lower_joints(spec: AssetSpec, given: Mapping[str, scene.Written]) -> tuple[Joint, ...]:
    """Return the joints of an asset at the ``given`` positions, keyed by name. Mimic joints follow their leaders.

    Each axis of a joint with several axes is a joint of its own, of which only the first has a pose.
    """
    joints = [
        _joint(name, joint, scene.position(spec, name, given), given) for name, joint in spec.single_joints.items()
    ]
    first = {joint.child: joint for joint in reversed(joints)}
    posed = (joint if first[joint.child] is joint else replace(joint, X_PC=IDENTITY) for joint in joints)
    return tuple(_with_actuator(joint, spec) for joint in posed)


def _with_actuator(joint: Joint, spec: AssetSpec) -> Joint:
    """Return the joint with a drive that acts like its first position or velocity actuator, unless it has a drive."""
    servos = ((n, a) for n, a in spec.actuators.items() if a.joint == joint.name and a.type != "motor" and a.gear)
    name, servo = next(servos, ("", None))
    if servo is None or joint.drive is not None or not joint.has_axis:
        return joint
    target = servo.control / servo.gear if servo.type == "position" else 0.0
    if joint.limits is not None:
        target = min(max(target, joint.limits[0]), joint.limits[1])
    limits = [max(map(abs, servo.force_range)) * abs(servo.gear)] if servo.force_range is not None else []
    limit = min([*limits, *([] if joint.effort is None else [joint.effort])], default=None)
    gear = servo.gear**2
    return replace(joint, drive=Drive((servo.kp or 0.0) * gear, servo.kv * gear, target, limit or None, name))


def attachments(spec: AssetSpec) -> dict[str, Any]:
    """Return the sites, actuators, sensors and native data of an asset, as fields of an object."""
    sites = (Site(n, s.link, pose(s.pose), _mjcf(s)) for n, s in spec.sites.items())
    keys = ("type", "joint", "gear", "kv", "control", "control_range", "force_range")
    actuators = (
        Actuator(n, kp=a.kp or 0.0, mjcf=_mjcf(a), **{key: getattr(a, key) for key in keys})
        for n, a in spec.actuators.items()
    )
    sensors = []
    for name, s in spec.sensors.items():
        place = next(p for p in ("site", "joint", "link") if getattr(s, p) is not None)
        sensors.append(Sensor(name, s.type, place, getattr(s, place), s.noise, s.cutoff, _mjcf(s)))
    native = NativeAttributes(
        {n: _mjcf(k) for n, k in spec.links.items() if _mjcf(k)},
        {n: _mjcf(j) for n, j in spec.single_joints.items() if _mjcf(j)},
        {(n, m): _mjcf(p) for n, k in spec.links.items() for m, p in k.parts.items() if _mjcf(p)},
    )
    return {"sites": tuple(sites), "actuators": tuple(actuators), "sensors": tuple(sensors), "native": native}


def inline_native(item: scene.ObjectSpec) -> NativeAttributes:
    """Return the native data of an object with an inline shape, whose body and part share their attributes."""
    given = dict(_mjcf(item))
    merge = given.pop("merge", False)
    of_link = ({"merge": merge} if merge else {}) | ({"exact": given["exact"]} if "exact" in given else {})
    links = {"base": of_link} if of_link else {}
    return NativeAttributes(links, {}, {("base", "shape"): given} if given else {})


def _mjcf(spec: Any) -> Mapping[str, Any]:
    return MappingProxyType({} if spec.native is None else spec.native.mjcf)


def _joint(name: str, spec: JointSpec, position: float, given: Mapping[str, scene.Written]) -> Joint:
    limits, drive, written = spec.limits, None, given.get(name)
    if spec.limits_deg is not None:
        limits = (math.radians(spec.limits_deg[0]), math.radians(spec.limits_deg[1]))
    if (motor := spec.drive) is not None:
        target = position if motor.target is None else motor.target
        strongest = min((force for force in (motor.force_limit, spec.effort) if force is not None), default=None)
        drive = Drive(motor.stiffness, motor.damping, target, strongest)
    axis = np.array(spec.axis) / np.linalg.norm(spec.axis) if any(spec.axis) else np.array([0.0, 0.0, 1.0])
    return Joint(
        name=name,
        type=JointType(spec.type or "fixed"),  # a single joint always has a type
        parent=spec.parent,
        child=spec.child,
        X_PC=pose(spec.pose),
        axis=frozen(axis, (3,)),
        limits=limits,
        damping=spec.damping,
        friction=spec.friction,
        armature=spec.armature,
        effort=spec.effort,
        velocity=spec.velocity if spec.velocity_deg is None else math.radians(spec.velocity_deg),
        position=position,
        motion=pose(written) if isinstance(written, base.PoseSpec) else IDENTITY,
        mimic=None if spec.mimic is None else Mimic(spec.mimic.joint, spec.mimic.multiplier, spec.mimic.offset),
        drive=drive,
        closed=spec.closed,
    )
