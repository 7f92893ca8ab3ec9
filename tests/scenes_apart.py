"""In what two lowered scenes differ, field by field, each with its feature of ``docs/support.md``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull, cKDTree

from simfoundry.geometry.frames import Array, Pose
from simfoundry.geometry.shapes import Box, Capsule, Cylinder, Geometry, Mesh, Sphere
from simfoundry.scene.kinematics import excluded_link_pairs
from simfoundry.scene.model import (
    Camera,
    Collider,
    Joint,
    JointType,
    Light,
    LightType,
    Link,
    Scene,
    SceneObject,
    Visual,
)
from simfoundry.scene.robot import Robot

RELATIVE, METERS, RADIANS = 1e-6, 1e-6, 1e-6


@dataclass(frozen=True)
class Apart:
    """One field that differs: where, of which feature, and what each scene says."""

    path: str
    feature: str
    words: str

    def __str__(self) -> str:
        return f"{self.path} [{self.feature}] {self.words}"


def apart(one: Scene, two: Scene) -> list[Apart]:
    """Everything in which ``two`` differs from ``one``; the document behind a scene is not looked at."""
    return list(_scene(one, two))


def objects_apart(one: SceneObject, two: SceneObject) -> list[Apart]:
    """Everything in which an object differs from another."""
    return list(_object(one, two))


def _scene(one: Scene, two: Scene) -> Iterator[Apart]:
    yield from _same("name", "name", one.name, two.name)
    yield from _close("gravity", "gravity", one.gravity, two.gravity)
    yield from _same("relations", "relations", _words(one.relations), _words(two.relations))
    pairs = [sorted(tuple(sorted(pair)) for pair in scene.no_contact) for scene in (one, two)]
    yield from _same("no_contact", "no_contact", *pairs)
    yield from _each("objects", "pose", _by_name(one.objects), _by_name(two.objects), _object)
    yield from _each("cameras", "cameras", _by_name(one.cameras), _by_name(two.cameras), _camera)
    machines = [{r.name: r for r in scene.robots} for scene in (one, two)]
    yield from _each("robots", "robots", machines[0], machines[1], _robot)
    riders = [{f"{m.carrier}.{m.link}.{m.camera.name}": m.camera for m in scene.mounted} for scene in (one, two)]
    yield from _each("mounted", "mounted_cameras", riders[0], riders[1], _camera)
    yield from _each("lights", "distant_lights", _by_name(one.lights), _by_name(two.lights), _light)
    yield from _background(one, two)


def _robot(one: Robot, two: Robot) -> Iterator[Apart]:
    yield from _same("kind", "robots", one.kind, two.kind)
    yield from _same("positions", "robots", dict(one.positions), dict(two.positions))
    yield from _same("sizes", "robots", (one.reach, one.opening), (two.reach, two.opening))
    yield from _pose("pose", "robots", one.X_WB, two.X_WB)


def _background(one: Scene, two: Scene) -> Iterator[Apart]:
    seen = [() if s.background is None else s.background.visuals for s in (one, two)]
    frames = [Pose.of() if s.background is None else s.background.X_WB for s in (one, two)]
    yield from _same("background", "background_mesh", len(seen[0]), len(seen[1]))
    for a, b in zip(*seen, strict=False):
        yield from _geometry(
            "background", "background_mesh", (a.geometry, frames[0] @ a.X_LG), (b.geometry, frames[1] @ b.X_LG)
        )
    splats = [s.background is not None and s.background.splat is not None for s in (one, two)]
    yield from _same("background", "background_splat", *splats)


def _object(one: SceneObject, two: SceneObject) -> Iterator[Apart]:
    yield from _same("category", "category", one.category, two.category)
    yield from _same("labels", "labels", list(one.labels), list(two.labels))
    yield from _same("fixed", "fixed", one.fixed, two.fixed)
    yield from _pose("pose", "pose", one.X_WO, two.X_WO)
    yield from _same("root", "link_names", one.root.name, two.root.name)
    variants = [sorted((o.variant, *(v.variant for v in o.variants))) for o in (one, two)]
    yield from _same("variants", "variants", *variants)
    yield from _same("no_contact", "no_contact", sorted(excluded_link_pairs(one)), sorted(excluded_link_pairs(two)))
    yield from _each("links", "link_names", _by_name(one.links), _by_name(two.links), _link)
    yield from _each("joints", "joint_names", _by_name(one.joints), _by_name(two.joints), _joint)


def _link(one: Link, two: Link) -> Iterator[Apart]:
    yield from _close("mass", "mass", one.mass, two.mass)
    yield from _close("com", "inertia", one.com, two.com, METERS)
    size = float(np.linalg.norm(one.inertia))
    if float(np.abs(one.inertia - two.inertia).max()) > 10 * RELATIVE * size:
        yield Apart("inertia", "inertia", f"{one.inertia.tolist()} | {two.inertia.tolist()}")
    yield from _each("visuals", "visuals", _by_name(one.visuals), _by_name(two.visuals), _visual)
    yield from _each("colliders", "colliders", _by_name(one.colliders), _by_name(two.colliders), _collider)


def _visual(one: Visual, two: Visual) -> Iterator[Apart]:
    yield from _geometry("", "visuals", (one.geometry, one.X_LG), (two.geometry, two.X_LG))
    yield from _close("color", "visuals", one.rgba, two.rgba, 1e-3)
    textures = [g.texture is not None if isinstance(g, Mesh) else False for g in (one.geometry, two.geometry)]
    yield from _same("texture", "texture", *textures)


def _collider(one: Collider, two: Collider) -> Iterator[Apart]:
    yield from _geometry("", shape_feature(one.geometry), (one.geometry, one.X_LG), (two.geometry, two.X_LG))
    for name in ("friction", "restitution", "torsional_friction", "rolling_friction"):
        yield from _close(name, name, getattr(one, name), getattr(two, name))


def shape_feature(geometry: Geometry) -> str:
    """The feature that a collider of a geometry is."""
    return "convex_mesh" if isinstance(geometry, Mesh) else type(geometry).__name__.lower()


def _joint(one: Joint, two: Joint) -> Iterator[Apart]:
    yield from _same("type", "fixed_joint" if one.type is JointType.FIXED else one.type.value, one.type, two.type)
    yield from _same("parent", "joint_names", one.parent, two.parent)
    yield from _same("child", "joint_names", one.child, two.child)
    if one.type is not two.type:  # of another type it has other fields; but the child has to stand where it stood
        yield from _pose("stands", "pose", one.X_PC @ one.motion, two.X_PC @ two.motion)
        return
    yield from _pose("X_PC", "pose", one.X_PC, two.X_PC)
    if one.has_axis:
        yield from _close("axis", one.type.value, one.axis, two.axis)
        yield from _same("limits", "joint_limits", one.limits is None, two.limits is None)
        if one.limits is not None and two.limits is not None:
            yield from _close("limits", "joint_limits", one.limits, two.limits, RADIANS)
        yield from _same("closed", "joint_closed", one.closed, two.closed)
        yield from _close("position", "joint_position", one.position, two.position, RADIANS)
    for name, feature in (("damping", "joint_damping"), ("friction", "joint_friction"), ("armature", "armature")):
        yield from _close(name, feature, getattr(one, name), getattr(two, name))
    yield from _pose("motion", "joint_position", one.motion, two.motion)
    for name in ("mimic", "drive"):
        laws = [None if getattr(j, name) is None else vars(getattr(j, name)) for j in (one, two)]
        yield from _law(name, laws[0], laws[1])


def _law(name: str, one: Mapping[str, Any] | None, two: Mapping[str, Any] | None) -> Iterator[Apart]:
    if one is None or two is None:
        yield from _same(name, name, one, two)
        return
    for key, value in one.items():
        same = value == two[key] if value is None or isinstance(value, str) or two[key] is None else None
        if same is None:
            yield from _close(f"{name}.{key}", name, value, two[key])
        elif not same:
            yield Apart(f"{name}.{key}", name, f"{value} | {two[key]}")


def _camera(one: Camera, two: Camera) -> Iterator[Apart]:
    yield from _same("size", "cameras", (one.width, one.height), (two.width, two.height))
    for name in ("fx", "fy", "cx", "cy"):
        yield from _close(name, "cameras", getattr(one, name), getattr(two, name), 1e-3)
    yield from _pose("pose", "cameras", one.X_WC, two.X_WC)


def _light(one: Light, two: Light) -> Iterator[Apart]:
    feature = f"{one.type.value}_lights"
    yield from _same("type", feature, one.type, two.type)
    yield from _close("color", feature, one.intensity * one.rgb, two.intensity * two.rgb, 1e-4)
    if one.type is LightType.POINT:
        yield from _close("xyz", feature, one.X_WL.p, two.X_WL.p, METERS)
    if one.type is LightType.DISTANT:
        yield from _close("direction", feature, one.X_WL.rotation[:, 2], two.X_WL.rotation[:, 2], RADIANS)


def _geometry(path: str, feature: str, one: tuple[Geometry, Pose], two: tuple[Geometry, Pose]) -> Iterator[Apart]:
    (a, X_A), (b, X_B) = one, two
    if type(a) is not type(b):
        yield Apart(path, feature, f"{type(a).__name__} | {type(b).__name__}")
        return
    match a, b:
        case Mesh(), Mesh():
            yield from _meshes(path, feature, (a, X_A), (b, X_B))
            return
        case Box(), Box():
            yield from _close(f"{path}size", feature, a.size, b.size)
        case (Sphere(), Sphere()) | (Cylinder(), Cylinder()) | (Capsule(), Capsule()):
            yield from _close(f"{path}size", feature, list(vars(a).values()), list(vars(b).values()))
    yield from _pose(f"{path}pose", feature, X_A, X_B)


def _meshes(path: str, feature: str, one: tuple[Mesh, Pose], two: tuple[Mesh, Pose]) -> Iterator[Apart]:
    """Meshes in their link: the same surface, whatever its frame, its order, and corners amid a flat face."""
    points = [pose.apply(mesh.vertices) for mesh, pose in (one, two)]
    if feature == "convex_mesh":
        far = max(_outside(points[0], points[1]), _outside(points[1], points[0]))
    else:
        middles = [p[m.faces].mean(axis=1) for p, (m, _) in zip(points, (one, two), strict=True)]
        if len(middles[0]) != len(middles[1]):
            yield Apart(path, feature, f"{len(middles[0])} | {len(middles[1])} triangles")
            return
        far = max(float(cKDTree(middles[i]).query(middles[1 - i])[0].max()) for i in (0, 1))
    if far > METERS:
        yield Apart(path, feature, f"its surface is {far * 1e3:.3g} mm off")


def _outside(points: Array, corners: Array) -> float:
    """How far [m] the farthest of some points lies outside the convex hull of some corners."""
    planes = ConvexHull(corners).equations
    return float((points @ planes[:, :3].T + planes[:, 3]).max())


def _pose(path: str, feature: str, one: Pose, two: Pose) -> Iterator[Apart]:
    moved = float(np.abs(one.p - two.p).max())
    turned = 2 * float(np.sqrt(max(0.0, 1 - min(1.0, abs(float(one.q @ two.q))) ** 2)))
    if moved > METERS or turned > 10 * RADIANS:
        yield Apart(path, feature, f"{moved * 1e3:.3g} mm and {np.degrees(turned):.3g} deg off")


def _close(path: str, feature: str, one: Any, two: Any, least: float = 1e-9) -> Iterator[Apart]:
    a, b = np.atleast_1d(np.asarray(one, dtype=float)), np.atleast_1d(np.asarray(two, dtype=float))
    if a.shape != b.shape or not np.allclose(a, b, rtol=RELATIVE, atol=least):
        yield Apart(path, feature, f"{np.round(a, 9).tolist()} | {np.round(b, 9).tolist()}")


def _same(path: str, feature: str, one: Any, two: Any) -> Iterator[Apart]:
    if one != two:
        yield Apart(path, feature, f"{one} | {two}")


def _each(path: str, feature: str, one: Mapping[str, Any], two: Mapping[str, Any], inside: Any) -> Iterator[Apart]:
    if set(one) != set(two):
        missing, extra = sorted(set(one) - set(two)), sorted(set(two) - set(one))
        yield Apart(path, feature, f"not there: {missing}; more: {extra}")
    for name in one:
        if name in two:
            for each in inside(one[name], two[name]):
                yield Apart(f"{name}.{each.path}".rstrip("."), each.feature, each.words)


def _by_name(things: Sequence[Any]) -> dict[str, Any]:
    return {thing.name: thing for thing in things}


def _words(values: Sequence[object]) -> list[str]:
    return sorted(str(value) for value in values)
