"""Warn about single lengths in millimeters: what is far from everything else, far larger than it, or far too heavy.

Each rule compares one value with the rest of the same document, so that large scenes remain without warnings.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

from simfoundry.spec.check.checker import Checker, Path_, volume
from simfoundry.spec.check.plausible import LARGEST, dimensions
from simfoundry.spec.models.base import BodySpec, Material, quantity_value
from simfoundry.spec.models.shapes import Shape, shape_parts

if TYPE_CHECKING:
    from simfoundry.spec.models.asset import AssetSpec
    from simfoundry.spec.models.scene import SceneSpec

# Distance [m] from which something in a scene may be an outlier, and its least ratio to the extent of all others. A
# length in millimeters is 1000 times too large; 10 leaves room for a scene in which one thing is really far away.
FAR, FAR_RATIO = 10.0, 10.0

# The same distance for a camera, which may have a long lens.
FAR_CAMERA = 50.0

# Extent [m] of a scene that is assumed at least, so that things at a single point have none.
LEAST_EXTENT = 0.5

# Offset [m] in an asset from which a part may be an outlier, and its least ratio to the extent of all other parts.
OFFSET, OFFSET_RATIO = 1.0, 10.0

# Size [m] from which a part of an asset may be an outlier, and its least ratio to the extent of all others. Rails are
# up to 20 times as long as their carriages.
LARGE, LARGE_RATIO = 2.0, 20.0

# Distance [m] of a mounted camera from its mount that is too large for any robot.
FAR_FROM_MOUNT = 5.0

# Mass [kg] of a movable body above which its size is probably in millimeters; a loaded truck has 40 t.
HEAVIEST_BODY = 50_000.0

_HINT = "lengths are in m; for 40 mm, write 0.04"


class _Length(NamedTuple):
    name: str
    path: Path_
    value: float
    is_size: bool


def check_scene_outliers(c: Checker, spec: SceneSpec) -> None:
    """Check that no object, robot or camera is far from all others, and that no movable object is far too heavy."""
    points = [*_points(spec)]
    if len(points) > 2:
        center = [statistics.median(point[k] for _, point in points) for k in range(3)]
        distances = sorted(((math.dist(point, center), k) for k, (_, point) in enumerate(points)), reverse=True)
        (far, k), (rest, _) = distances[:2]
        path = points[k][0]
        if far > (FAR_CAMERA if path[0] == "cameras" else FAR) and far > FAR_RATIO * max(rest, LEAST_EXTENT):
            c.warn("SF439", path, f"`{path[1]}` is {far:.4g} m from everything else", _HINT)
    for name, camera in spec.cameras.items():
        distance = math.hypot(*camera.pose.xyz)
        if camera.mount is not None and distance > FAR_FROM_MOUNT:
            path = ("cameras", name, "pose", "xyz")
            c.warn("SF439", path, f"`{name}` is {distance:.4g} m from its mount", _HINT)
    for name, item in spec.objects.items():
        if item.shape is not None and not item.fixed:
            path = ("objects", name, "shape")
            parts = shape_parts(item.shape)
            shapes = [((*path, "compound", key), part.shape, part.material) for key, part in parts.items()]
            _check_weight(c, name, item, shapes or [(path, item.shape, None)], spec.materials)


def _points(spec: SceneSpec) -> Iterator[tuple[Path_, Sequence[float]]]:
    """Yield the positions in the world that are written in a scene, with their paths."""
    for name, item in spec.objects.items():
        if item.place is None and item.pose.frame is None:
            yield ("objects", name, "pose", "xyz"), item.pose.xyz
    for name, robot in spec.robots.items():
        if robot.pose.frame is None:
            yield ("robots", name, "pose", "xyz"), robot.pose.xyz
    for name, camera in spec.cameras.items():
        if camera.mount is None and camera.pose.frame is None:
            yield ("cameras", name, "pose", "xyz"), camera.pose.xyz
            if isinstance(camera.pose.look_at, tuple):
                yield ("cameras", name, "pose", "look_at"), camera.pose.look_at


def check_asset_outliers(c: Checker, spec: AssetSpec) -> None:
    """Check that no part of an asset is far from all others, far larger than them, or far too heavy."""
    for name, link in spec.links.items():
        solid = [(key, part) for key, part in link.parts.items() if part.use != "visual" and part.shape is not None]
        shapes = [(("links", name, "parts", key, "shape"), part.shape, part.material) for key, part in solid]
        _check_weight(c, name, link, [(p, s, m) for p, s, m in shapes if s is not None], spec.materials)
    if any(part.shape is None for link in spec.links.values() for part in link.parts.values()):
        return  # the size of a mesh is not known here
    lengths = [*_lengths(spec)]
    for found in lengths:
        others = [other.value for other in lengths if other.path != found.path or other.is_size != found.is_size]
        if found.is_size:  # the other lengths of the same part do not count
            others = [other.value for other in lengths if other.name != found.name]
        extent = max(others, default=0.0)
        least, ratio = (LARGE, LARGE_RATIO) if found.is_size else (OFFSET, OFFSET_RATIO)
        if extent and found.value > least and found.value > ratio * extent:
            what = "has a dimension of" if found.is_size else "is offset by"
            message = f"`{found.name}` {what} {found.value:.4g} m, but everything else is within {extent:.3g} m"
            c.warn("SF439", found.path, message, _HINT)


def _lengths(spec: AssetSpec) -> Iterator[_Length]:
    """Yield the largest dimension and the offset of each part, and the offset of each joint.

    The base of a mechanism may be a long rail, so that its size is not compared with that of the carriage.
    """
    for link_name, link in spec.links.items():
        for name, part in link.parts.items():
            path: Path_ = ("links", link_name, "parts", name)
            sizes = [*dimensions(part.shape, (*path, "shape"))] if part.shape is not None else []
            is_rail = len(link.parts) == 1 and len(spec.links) > 1 and link_name == next(iter(spec.links))
            if sizes and not is_rail:
                at, value = max(sizes, key=lambda each: each[1])
                yield _Length(name, at, value, True)
            yield _Length(name, (*path, "pose", "xyz"), math.hypot(*part.pose.xyz), False)
    for name, joint in spec.joints.items():
        yield _Length(name, ("joints", name, "pose", "xyz"), math.hypot(*joint.pose.xyz), False)


def _is_reported(shape: Shape) -> bool:
    """Return True if a shape is so large that its size is reported by itself, such as a ground plane in an asset."""
    return any(length > LARGEST for _, length in dimensions(shape, ()))


def _check_weight(
    c: Checker,
    name: str,
    body: BodySpec,
    shapes: Sequence[tuple[Path_, Shape, str | None]],
    materials: Mapping[str, Material],
) -> None:
    """Check the mass that follows from the density of a movable body."""
    if body.mass is not None or not shapes or any(_is_reported(shape) for _, shape, _ in shapes):
        return
    given = quantity_value(body.density)
    masses: list[tuple[float, Path_]] = []
    for path, shape, own in shapes:
        material = materials.get(own or body.material or "")
        density = given if given is not None else material.density if material is not None else None
        masses.append(((density or 0.0) * volume(shape), path))
    total = sum(mass for mass, _ in masses)
    if HEAVIEST_BODY < total < math.inf:
        c.warn("SF402", max(masses)[1], f"`{name}` has a mass of {total:.3g} kg, because of its size", _HINT)
