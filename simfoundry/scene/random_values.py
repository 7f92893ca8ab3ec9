"""Random values of a recipe in terms of the lowered scene, for targets that draw them themselves."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Literal

from simfoundry.spec.check.varied_places import ValueKind, VariedField
from simfoundry.spec.check.varied_values import shift_ends
from simfoundry.spec.check.vary import VariedValue
from simfoundry.spec.models.cousins import CousinsSpec
from simfoundry.spec.models.scene import SceneSpec
from simfoundry.spec.models.vary import (
    EstimateDistribution,
    FactorDistribution,
    LogUniformDistribution,
    NormalAngleDistribution,
    NormalDistribution,
    ShiftDistribution,
    UniformDistribution,
)


class RandomQuantity(StrEnum):
    """The quantity of the simulation that a random value changes."""

    MASS = "mass"
    FRICTION = "friction"
    RESTITUTION = "restitution"
    GRAVITY = "gravity"
    POSE = "pose"
    JOINT_POSITION = "joint position"
    JOINT_FRICTION = "joint friction"
    JOINT_DAMPING = "joint damping"
    ARMATURE = "armature"
    OTHER = "other"


# A number between the ends, a number whose logarithm is, a normal error, a shift in a ball or box, or anything else.
RandomForm = Literal["uniform", "log_uniform", "normal", "ball", "box", "other"]


@dataclass(frozen=True)
class RandomValue:
    """A random value.

    Attributes:
        name: The path as in recipes.
        quantity: The quantity that it changes.
        elements: The objects or joints (``cabinet.drawer``) whose quantity changes.
        section: The first key of the path in its document, such as ``lights``.
        operation: The way in which the drawn number applies: it replaces the scene's value, or is added to it, or is a
            factor of it.
        form: The distribution.
        ends: The least and the greatest number, or the mean and the standard deviation of a normal error, in SI units.
        shift: The greatest shift along each axis, for shifts in a ball or box.
        turn: The greatest rotation about any axis [rad].
        yaw: The greatest rotation about z [rad].
        with_contents: True if what stands on the object moves along.
        together: The group of values that are drawn together, or empty.
    """

    name: str
    quantity: RandomQuantity = RandomQuantity.OTHER
    elements: tuple[str, ...] = ()
    section: str = ""
    operation: Literal["abs", "add", "scale"] = "abs"
    form: RandomForm = "other"
    ends: tuple[float, float] = (0.0, 0.0)
    shift: tuple[float, float, float] = (0.0, 0.0, 0.0)
    turn: float = 0.0
    yaw: float = 0.0
    with_contents: bool = False
    together: str = ""


# Section of the axes of a recipe other than `vary`.
AXIS = "axis"

_JOINT_KEYS = {
    "damping": RandomQuantity.JOINT_DAMPING,
    "friction": RandomQuantity.JOINT_FRICTION,
    "armature": RandomQuantity.ARMATURE,
}
_BODY_KEYS = {
    "mass": RandomQuantity.MASS,
    "density": RandomQuantity.MASS,
    "friction": RandomQuantity.FRICTION,
    "restitution": RandomQuantity.RESTITUTION,
}


def lower_random_values(
    recipe: CousinsSpec, values: Sequence[VariedValue], scene: SceneSpec
) -> tuple[RandomValue, ...]:
    """Return the random values of a recipe, followed by its other axes, which no target draws."""
    axes = ("scene", "distractors", "object", "task")
    others = [RandomValue(axis, section=AXIS) for axis in axes if getattr(recipe, axis) is not None]
    return (*(_lowered(value, scene) for value in values), *others)


def _lowered(value: VariedValue, scene: SceneSpec) -> RandomValue:
    field, rule = value.field, value.distribution
    quantity, elements = _subject(field, scene)
    operation, form, ends = _numbers(value)
    shift = rule.shift if isinstance(rule, ShiftDistribution) else None
    spatial = field.kind in (ValueKind.POSE, ValueKind.VECTOR)
    turns = isinstance(rule, ShiftDistribution)
    box: tuple[float, float, float] = (0.0, 0.0, 0.0)
    if spatial and shift is not None:
        operation, form = "add", "box" if isinstance(shift, tuple) else "ball"
        box = (shift[0], shift[1], shift[2]) if isinstance(shift, tuple) else (shift, shift, shift)
    elif spatial and turns:
        operation, form = "add", "box"
    return RandomValue(
        name=field.name,
        quantity=quantity,
        elements=elements,
        section=field.places[0].path[0],
        operation=operation,
        form=form,
        ends=ends,
        shift=box,
        turn=math.radians((rule.turn_deg or 0.0) if isinstance(rule, ShiftDistribution) else 0.0),
        yaw=math.radians((rule.yaw_deg or 0.0) if isinstance(rule, ShiftDistribution) else 0.0),
        with_contents=isinstance(rule, ShiftDistribution) and rule.with_contents,
        together=rule.together or "",
    )


def _numbers(value: VariedValue) -> tuple[Literal["abs", "add", "scale"], RandomForm, tuple[float, float]]:
    """Return the operation, the distribution and its ends, in radians for positions of joints in degrees."""
    place, unit = value.field.places[0], math.radians(1.0) if value.field.degrees else 1.0
    match value.distribution:
        case FactorDistribution(times=times):
            return "scale", "uniform", times
        case NormalDistribution(normal=deviation):
            return "add", "normal", (0.0, deviation * unit)
        case NormalAngleDistribution(normal_deg=deviation):
            return "add", "normal", (0.0, math.radians(deviation))
        case UniformDistribution() | EstimateDistribution():
            return "abs", "uniform", (place.ends[0] * unit, place.ends[1] * unit)
        case LogUniformDistribution():
            return "abs", "log_uniform", (place.ends[0] * unit, place.ends[1] * unit)
        case ShiftDistribution(shift=shift) if shift is not None and (ends := shift_ends(shift)) is not None:
            return "add", "uniform", (ends[0] * unit, ends[1] * unit)
    return "abs", "other", (0.0, 0.0)


def _subject(field: VariedField, scene: SceneSpec) -> tuple[RandomQuantity, tuple[str, ...]]:
    """Return the quantity that a value changes, and the objects or joints that have it."""
    place = field.places[0]
    path, key, other = place.path, place.path[-1], (RandomQuantity.OTHER, ())
    if path == ("gravity",):
        return RandomQuantity.GRAVITY, ()
    if field.kind is ValueKind.JOINT:
        return RandomQuantity.JOINT_POSITION, (f"{field.object}.{path[-1]}",) if path[0] != "robots" else ()
    if field.kind in (ValueKind.POSE, ValueKind.HEIGHT) and path[0] == "objects" and len(path) == 3:
        return RandomQuantity.POSE, (field.object,)
    if place.document.endswith(".asset"):
        if path[0] == "joints" and key in _JOINT_KEYS and len(path) in (3, 5):
            return _JOINT_KEYS[key], (f"{field.object}.{path[-2]}",)
        if path[0] == "links" and key in _BODY_KEYS and field.name == f"object.{field.object}.{key}":
            return _BODY_KEYS[key], (field.object,)
        return other
    if (
        path[0] == "objects"
        and key in _BODY_KEYS
        and field.name in (f"object.{path[1]}.{key}", f"object.{path[1]}.mass")
    ):
        return _BODY_KEYS[key], (path[1],)
    if path[0] == "materials" and key in ("friction", "restitution"):
        return _BODY_KEYS[key], tuple(_users(path[1], key, scene))
    return other


def _users(material: str, key: str, scene: SceneSpec) -> Iterator[str]:
    """Yield the objects that have the friction or restitution of a material of the scene."""
    for name, item in scene.objects.items():
        if item.material == material and getattr(item, key) is None:
            yield name
