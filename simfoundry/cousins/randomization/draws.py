"""Draw the values of the axis `vary` and turn them into entries of a cousin's documents."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from simfoundry.cousins.randomization.quantiles import QuantileSource
from simfoundry.cousins.recipe.document import relative
from simfoundry.geometry.frames import IDENTITY, Array, Pose
from simfoundry.scene.frames import FrameTree
from simfoundry.scene.model import Scene
from simfoundry.scene.state import pose, pose_spec
from simfoundry.spec.check.varied_places import ValueKind, VariedPlace
from simfoundry.spec.check.varied_values import CUTOFF, NO_ENDS, number_at, range_of, rounded_number
from simfoundry.spec.check.vary import VariedValue
from simfoundry.spec.files import Loaded, located
from simfoundry.spec.models.asset import LinkSpec
from simfoundry.spec.models.base import CameraPose, PoseSpec
from simfoundry.spec.models.scene import SceneSpec
from simfoundry.spec.models.vary import (
    ConeDistribution,
    FactorDistribution,
    NormalDistribution,
    ShiftDistribution,
)
from simfoundry.spec.yaml.write import to_data

# A drawn value in a manifest: a number, the text of a choice, or numbers by component.
DrawnValue = float | str | dict[str, float]


@dataclass(frozen=True, eq=False)
class TwinContext:
    """The properties of a twin on which draws depend.

    Attributes:
        spec: The twin's scene document.
        scene: The twin's lowered scene.
        recipe: The recipe, which the paths of files are relative to.
        out: Folder of the cousins.
        contents: Names of the objects that each object supports and that are not placed relative to it.
        arm_limits: Limits of arm joints [rad or m], by robot and joint; empty for robots whose model is not installed.
    """

    spec: SceneSpec
    scene: Scene
    recipe: Loaded
    out: Path
    contents: Mapping[str, tuple[str, ...]]
    arm_limits: Mapping[str, Mapping[str, tuple[float, float]]]


@dataclass(eq=False)
class DrawnValues:
    """The drawn values of one cousin.

    Attributes:
        values: The values by path, for the manifest.
        split: Name of the split, or empty.
        documents: Entries of the documents that differ from the twin, as nested data, by kind of document.
        poses: Poses X_WO of objects that moved.
        pictures_only: True if only pictures and other observations depend on the values.
        same_scene: True if the physics of the scene does not depend on the values.
        views: True if the pose or the lens of a camera varies.
    """

    values: dict[str, DrawnValue] = field(default_factory=dict)
    split: str = ""
    documents: dict[str, dict[str, Any]] = field(default_factory=dict)
    poses: dict[str, Pose] = field(default_factory=dict)
    pictures_only: bool = True
    same_scene: bool = True
    views: bool = False

    def write(self, document: str, path: Sequence[str], value: Any) -> None:
        """Add an entry to a document."""
        data = self.documents.setdefault(document, {})
        for key in path[:-1]:
            data = data.setdefault(key, {})
        key = path[-1]
        data[key] = {**data[key], **value} if isinstance(data.get(key), dict) and isinstance(value, dict) else value


def draw_values(values: Sequence[VariedValue], source: QuantileSource, context: TwinContext) -> DrawnValues:
    """Draw all values of a cousin."""
    drawn = DrawnValues(split=source.split)
    for value in values:
        drawn.values[value.field.name] = _DRAW[value.field.kind](value, source, context, drawn)
        drawn.pictures_only &= value.field.effect not in ("physics", "action")
        drawn.same_scene &= value.field.effect != "physics"
        drawn.views |= value.field.places[0].path[0] == "cameras"
    return drawn


# -- numbers and choices -----------------------------------------------------------------------------------------------


def _number(value: VariedValue, source: QuantileSource, context: TwinContext, drawn: DrawnValues) -> DrawnValue:
    """Draw a number or a joint position. If it has several places, they share the quantile or the factor."""
    if value.choices:
        return _choice(value, source, context, drawn)
    places, quantile = value.field.places, source.quantile(value.stream)
    written = []
    for place in places:
        number = rounded_number(number_at(value.distribution, place.base, place.ends, quantile), place.ends)
        written.append(float(round(number)) if value.field.whole else number)
        _write_number(place, written[-1], value, drawn)
    shared = len(places) > 1 or not value.field.name.endswith(f".{places[0].path[-1]}")  # a mass as a density
    if shared and isinstance(value.distribution, FactorDistribution):
        return rounded_number(number_at(value.distribution, None, value.distribution.times, quantile))
    return written[0]


def _write_number(place: VariedPlace, number: float, value: VariedValue, drawn: DrawnValues) -> None:
    entry: Any = {"deg": number} if value.field.degrees else int(number) if value.field.whole else number
    drawn.write(place.document, place.path, entry)
    link = place.owner
    inertial = link.inertial if isinstance(link, LinkSpec) and place.path[-1] == "mass" else None
    if inertial is not None and inertial.inertia is not None and place.base:  # an inertia is proportional to the mass
        scaled = tuple(rounded_number(v * number / place.base) for v in inertial.inertia)
        drawn.write(place.document, (*place.path[:-1], "inertial", "inertia"), scaled)


def _choice(value: VariedValue, source: QuantileSource, context: TwinContext, drawn: DrawnValues) -> DrawnValue:
    names = list(value.choices)
    name = names[source.choice(value.stream, len(names))]
    chosen = value.choices[name]
    if value.field.kind is ValueKind.FILE:
        chosen = _reference(chosen, context)
    for place in value.field.places:
        drawn.write(place.document, place.path, {"deg": chosen} if value.field.degrees else chosen)
    return float(chosen) if value.field.kind in (ValueKind.NUMBER, ValueKind.JOINT) else name


def _reference(reference: str, context: TwinContext) -> str:
    """Return the path of a file as it is written in a cousin."""
    if reference.startswith("pkg:"):
        return reference
    return relative(located(reference, context.recipe.path), context.out)


def _background(value: VariedValue, source: QuantileSource, context: TwinContext, drawn: DrawnValues) -> DrawnValue:
    names = list(value.choices)
    name = names[source.choice(value.stream, len(names))]
    drawn.write("scene", ("background",), {"mesh": _reference(value.choices[name], context)})
    return name


def _arm(value: VariedValue, source: QuantileSource, context: TwinContext, drawn: DrawnValues) -> DrawnValue:
    """Draw the positions of an arm's joints, each with a quantile of its own."""
    place, found = value.field.places[0], dict[str, float]()
    limits = context.arm_limits.get(value.field.object, {})
    for joint, position in place.base.items():
        ends = range_of(value.distribution, position)
        assert ends is not None
        low, high = limits.get(joint, NO_ENDS)
        ends = max(ends[0], min(low, position)), min(ends[1], max(high, position))
        quantile = source.quantile(value.stream, joint)
        found[joint] = rounded_number(number_at(value.distribution, position, ends, quantile), ends)
    drawn.write(place.document, place.path, found)
    return found


# -- vectors, colors and poses -----------------------------------------------------------------------------------------


def _vector(value: VariedValue, source: QuantileSource, context: TwinContext, drawn: DrawnValues) -> DrawnValue:
    """Draw a vector: a direction in a cone, a multiple, or a shifted position."""
    if value.choices:
        return _choice(value, source, context, drawn)
    place = value.field.places[0]
    base, rule = np.asarray(place.base, dtype=np.float64), value.distribution
    shown: DrawnValue
    if isinstance(rule, ConeDistribution):
        quantile = source.quantile(value.stream)
        # The area of a cap of the sphere is proportional to 1 - cos(angle).
        angle = math.acos(1 - quantile * (1 - math.cos(math.radians(rule.cone_deg))))
        turn = 2 * math.pi * source.free(value.stream, "turn")
        vector = _tilted(base, angle, turn)
        shown = {"angle_deg": _short(math.degrees(angle)), "turn_deg": _short(math.degrees(turn))}
    elif isinstance(rule, FactorDistribution):
        factor = number_at(rule, None, rule.times, source.quantile(value.stream))
        vector, shown = base * factor, rounded_number(factor)
    else:
        assert isinstance(rule, ShiftDistribution) and rule.shift is not None
        shift = _shift(rule.shift, value.stream, source)
        vector, shown = base + shift, _axes(shift)
    drawn.write(place.document, place.path, tuple(rounded_number(float(v)) for v in vector))
    return shown


def _color(value: VariedValue, source: QuantileSource, context: TwinContext, drawn: DrawnValues) -> DrawnValue:
    if value.choices:
        return _choice(value, source, context, drawn)
    assert isinstance(value.distribution, ShiftDistribution) and value.distribution.shift is not None
    shift = _shift(value.distribution.shift, value.stream, source)
    for place in value.field.places:
        color = np.clip(np.asarray(place.base[:3], dtype=np.float64) + shift, 0.0, 1.0)
        drawn.write(place.document, place.path, (*(_short(float(v)) for v in color), *place.base[3:]))
    return dict(zip(("red", "green", "blue"), (_short(float(v)) for v in shift), strict=True))


def _pose(value: VariedValue, source: QuantileSource, context: TwinContext, drawn: DrawnValues) -> DrawnValue:
    """Draw a pose: a shift in the parent frame, and a rotation about the frame's own origin."""
    place, rule = value.field.places[0], value.distribution
    assert isinstance(rule, ShiftDistribution)
    shift = _shift(rule.shift, value.stream, source) if rule.shift is not None else np.zeros(3)
    shown = _axes(shift) if rule.shift is not None else {}
    rotation = IDENTITY
    if rule.turn_deg is not None:
        # The cube root makes the rotation vector uniform in a ball.
        angle = rule.turn_deg * source.quantile(value.stream, "turn") ** (1 / 3)
        rotation = _rotation(math.radians(angle), _direction(value.stream, "turn", source))
        shown["turn_deg"] = _short(angle)
    if rule.yaw_deg is not None:
        yaw = rule.yaw_deg * (2 * source.quantile(value.stream, "yaw") - 1)
        rotation, shown["yaw_deg"] = _rotation(math.radians(yaw), np.array([0.0, 0.0, 1.0])), _short(yaw)
    X_PF = _base_pose(place, context)
    moved = Pose.of(X_PF.p + shift, (rotation @ Pose.of(q=X_PF.q)).q)
    if place.path[0] == "objects":
        _move_object(place.path[1], moved, rule.with_contents, context, drawn)
    else:
        drawn.write(place.document, place.path, _pose_data(place.base, moved))
    return shown


def _height(value: VariedValue, source: QuantileSource, context: TwinContext, drawn: DrawnValues) -> DrawnValue:
    """Draw the height of an object, whose contents move along if the recipe says so."""
    name, rule = value.field.object, value.distribution
    if isinstance(rule, NormalDistribution):
        ends = (-CUTOFF * rule.normal, CUTOFF * rule.normal)
    else:
        found = range_of(rule, 0.0)
        assert found is not None
        ends = found
    shift = rounded_number(number_at(rule, 0.0, ends, source.quantile(value.stream)), ends)
    X_WO = context.scene.object(name).X_WO
    along = isinstance(rule, ShiftDistribution) and rule.with_contents
    _move_object(name, Pose.of(X_WO.p + np.array([0.0, 0.0, shift]), X_WO.q), along, context, drawn)
    return shift


def _move_object(name: str, X_WO: Pose, with_contents: bool, context: TwinContext, drawn: DrawnValues) -> None:
    """Move an object and, if ``with_contents`` is set, the objects that it supports."""
    motion = X_WO @ context.scene.object(name).X_WO.inverse()
    for other in (name, *(context.contents.get(name, ()) if with_contents else ())):
        before = drawn.poses.get(other, context.scene.object(other).X_WO)
        drawn.poses[other] = motion @ before


def _base_pose(place: VariedPlace, context: TwinContext) -> Pose:
    """Return the twin's pose: of an object in the world, of a camera in the world or its mount, else in its frame."""
    if place.path[0] == "objects":
        return context.scene.object(place.path[1]).X_WO
    if isinstance(place.base, CameraPose):
        mount = context.spec.cameras[place.path[1]].mount
        mounted = {item.camera.name: item.camera for item in context.scene.mounted}
        if mount is not None and place.path[1] in mounted:
            return mounted[place.path[1]].X_WC
        return FrameTree(context.spec).camera_pose(place.base, context.scene.by_name)
    assert isinstance(place.base, PoseSpec)
    return pose(place.base)


def _pose_data(base: PoseSpec | CameraPose, moved: Pose) -> dict[str, Any]:
    """Return the entries of a pose that replace those of the twin."""
    xyz = tuple(rounded_number(float(v)) for v in np.round(moved.p, 6))
    if isinstance(base, CameraPose):
        frame = {"frame": None} if base.frame is not None else {}
        return {**frame, "xyz": xyz, "quat_wxyz": tuple(round(float(v), 6) for v in moved.q)}
    data = to_data(pose_spec(moved))
    turned = base.yaw_deg is not None or base.rpy_deg is not None or base.quat_wxyz is not None
    rotation: dict[str, Any] = {key: data[key] for key in ("yaw_deg", "rpy_deg") if key in data}
    if turned and not rotation:
        rotation["yaw_deg"] = 0.0
    return {"xyz": xyz, **rotation}


# -- geometry ----------------------------------------------------------------------------------------------------------


def _shift(shift: float | tuple[float, ...], stream: str, source: QuantileSource) -> Array:
    """Return a shift that is uniform in a ball or, with three numbers, in a box, shape (3,).

    Its size is the quantile, so that splits are shells around the twin's value. The cube root makes the shifts uniform
    in space.
    """
    size = source.quantile(stream) ** (1 / 3)
    if not isinstance(shift, tuple):
        return np.asarray(shift * size * _direction(stream, "", source), dtype=np.float64)
    corner = np.array([2 * source.free(stream, axis) - 1 for axis in "xyz"])
    outward = corner / max(float(np.abs(corner).max()), 1e-12)  # a draw at the very center has no direction
    return np.asarray(np.array(shift) * size * outward, dtype=np.float64)


def _direction(stream: str, component: str, source: QuantileSource) -> Array:
    """Return a unit vector that is uniform on the sphere, shape (3,)."""
    z = 2 * source.free(stream, f"{component} z") - 1
    around = 2 * math.pi * source.free(stream, f"{component} around")
    radius = math.sqrt(max(0.0, 1 - z * z))
    return np.array([radius * math.cos(around), radius * math.sin(around), z])


def _rotation(angle: float, axis: Array) -> Pose:
    """Return the rotation by ``angle`` [rad] about a unit vector, as a pose at the origin."""
    x, y, z = (math.sin(angle / 2) * float(v) for v in axis)
    return Pose.of(q=(math.cos(angle / 2), x, y, z))


def _tilted(vector: Array, angle: float, turn: float) -> Array:
    """Return a vector tilted by ``angle`` in the direction ``turn`` about itself [rad], with the same length."""
    length = float(np.linalg.norm(vector))
    along = vector / length
    # Any vector that is not parallel serves as a reference for the direction of the tilt.
    other = np.array([0.0, 0.0, 1.0]) if abs(along[2]) < 0.9 else np.array([1.0, 0.0, 0.0])
    x = np.cross(other, along)
    x /= np.linalg.norm(x)
    y = np.cross(along, x)
    side = math.cos(turn) * x + math.sin(turn) * y
    return np.asarray(length * (math.cos(angle) * along + math.sin(angle) * side), dtype=np.float64)


def _axes(shift: Array) -> dict[str, float]:
    return dict(zip("xyz", (_short(float(v)) for v in shift), strict=True))


def _short(number: float) -> float:
    """Round a number to the six decimals of documents."""
    return round(number, 6) + 0.0


_DRAW = {
    ValueKind.NUMBER: _number, ValueKind.JOINT: _number, ValueKind.ARM: _arm, ValueKind.VECTOR: _vector,
    ValueKind.POSE: _pose, ValueKind.HEIGHT: _height, ValueKind.COLOR: _color, ValueKind.FILE: _choice,
    ValueKind.BACKGROUND: _background, ValueKind.WORD: _choice,
}  # fmt: skip
