"""Check the axis `vary` of a recipe, and resolve its entries to values that can be drawn without further checks."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from pydantic import ValidationError

from simfoundry.spec.check.varied_choices import VaryProblem, choices_of
from simfoundry.spec.check.varied_fields import FieldFinder
from simfoundry.spec.check.varied_places import ValueKind, VariedField, VariedPlace, VaryPathError
from simfoundry.spec.check.varied_values import range_of
from simfoundry.spec.files import Loaded
from simfoundry.spec.models.base import Model
from simfoundry.spec.models.cousins import CousinsSpec
from simfoundry.spec.models.types import RIVALS
from simfoundry.spec.models.vary import (
    AnyDistribution,
    ChoiceDistribution,
    ConeDistribution,
    Distribution,
    EstimateDistribution,
    FactorDistribution,
    LogUniformDistribution,
    NormalAngleDistribution,
    NormalDistribution,
    ShiftDistribution,
    UniformDistribution,
)

# Distributions of each kind of value.
_NUMBERS = (UniformDistribution, FactorDistribution, ShiftDistribution, NormalDistribution, ChoiceDistribution)
FITTING: Mapping[ValueKind, tuple[type[Distribution], ...]] = {
    ValueKind.NUMBER: (*_NUMBERS, LogUniformDistribution, EstimateDistribution),
    ValueKind.JOINT: (*_NUMBERS, NormalAngleDistribution),
    ValueKind.ARM: (NormalAngleDistribution, ShiftDistribution),
    ValueKind.VECTOR: (ShiftDistribution, FactorDistribution, ConeDistribution, ChoiceDistribution),
    ValueKind.POSE: (ShiftDistribution,),
    ValueKind.HEIGHT: (ShiftDistribution, NormalDistribution),
    ValueKind.COLOR: (ChoiceDistribution, ShiftDistribution),
    ValueKind.FILE: (ChoiceDistribution,),
    ValueKind.BACKGROUND: (ChoiceDistribution,),
    ValueKind.WORD: (ChoiceDistribution,),
}
# Distributions around the twin's value.
_RELATIVE = (FactorDistribution, ShiftDistribution, NormalDistribution, NormalAngleDistribution, ConeDistribution)


# Greatest shift of a pose [m]. Scenes are cells and rooms, so that a larger shift is in another unit.
FARTHEST_SHIFT = 1000.0


@dataclass(frozen=True)
class VariedValue:
    """A value with its distribution.

    Attributes:
        field: The value.
        entry: The path as written in the recipe.
        distribution: The distribution.
        choices: The values to choose from, by the text that stands for each of them; empty for other distributions.
    """

    field: VariedField
    entry: str
    distribution: AnyDistribution
    choices: Mapping[str, Any]

    @property
    def stream(self) -> str:
        """The name of the random stream, which entries that are drawn together share."""
        together = self.distribution.together
        return self.field.name if together is None else f"together {together}"


def varied_values(
    spec: CousinsSpec, finder: FieldFinder, recipe: Loaded
) -> tuple[list[VariedValue], list[VaryProblem]]:
    """Return the values that a recipe varies, in the order of the recipe, and the problems of its entries."""
    found: list[VariedValue] = []
    problems: list[VaryProblem] = []
    for entry, distribution in spec.vary.items():
        try:
            fields = finder.find(entry, isinstance(distribution, FactorDistribution | EstimateDistribution))
        except VaryPathError as error:
            problems.append(VaryProblem("SF201", (entry,), error.message, error.hint))
            continue
        values, wrong = _resolved(entry, distribution, fields, finder, recipe)
        problems += wrong or _split_problems(spec, entry, values)
        found += values
    found, clashes = _once(found)
    return found, [*problems, *clashes, *_axis_problems(spec, found)]


def _resolved(
    entry: str, distribution: AnyDistribution, fields: list[VariedField], finder: FieldFinder, recipe: Loaded
) -> tuple[list[VariedValue], list[VaryProblem]]:
    """Return the values of an entry. A pattern skips values that the twin does not state."""
    values: list[VariedValue] = []
    skipped: list[VaryProblem] = []
    for field in fields:
        if not isinstance(distribution, FITTING[field.kind]):
            return [], [_misfit(entry, distribution, field)]
        if isinstance(distribution, ShiftDistribution) and (wrong := _shift_misfit(entry, distribution, field)):
            return [], [wrong]
        if isinstance(distribution, NormalAngleDistribution) and not field.turns:
            message = f"`{field.name}` does not rotate, so `normal_deg` does not fit it"
            return [], [VaryProblem("SF107", (entry, "normal_deg"), message, "use `normal`, in meters")]
        missing = _missing(entry, distribution, field)
        if missing is not None:
            skipped.append(missing)
            continue
        choices, wrong = choices_of(entry, distribution, field, finder, recipe)
        if wrong is None:
            field, wrong = _bounded(entry, distribution, field, choices)
        if wrong is not None:
            return [], [wrong]
        values.append(VariedValue(field, entry, distribution, choices))
    return values, ([] if values else skipped[:1])


def _key(distribution: AnyDistribution) -> str:
    return next(key for key in type(distribution).model_fields if key in distribution.model_fields_set)


def _misfit(entry: str, distribution: AnyDistribution, field: VariedField) -> VaryProblem:
    keys = [key for kind in FITTING[field.kind] for key in list(kind.model_fields)[:1]]
    message = f"`{_key(distribution)}` does not fit `{field.name}`, which is {field.kind}"
    listed = ", ".join(f"`{key}`" for key in dict.fromkeys(keys))
    return VaryProblem("SF107", (entry, _key(distribution)), message, f"{field.kind} can have: {listed}")


def _shift_misfit(entry: str, shift: ShiftDistribution, field: VariedField) -> VaryProblem | None:
    """Return a problem if the keys of a shift do not fit a value."""
    for key in ("turn_deg", "yaw_deg"):
        if getattr(shift, key) is not None and field.kind is not ValueKind.POSE:
            return VaryProblem("SF107", (entry, key), f"`{key}` does not fit `{field.name}`, which is {field.kind}")
    spatial = field.kind in (ValueKind.POSE, ValueKind.VECTOR, ValueKind.COLOR)
    if isinstance(shift.shift, tuple) and len(shift.shift) != (3 if spatial else 2):
        takes = "the greatest shift, or three for x, y and z" if spatial else "the greatest shift, or two: the range"
        message = f"`shift` of `{field.name}` has {len(shift.shift)} numbers, but it is {field.kind}"
        return VaryProblem("SF105", (entry, "shift"), message, f"write {takes}")
    values = shift.shift if isinstance(shift.shift, tuple) else (shift.shift or 0.0,)
    if field.kind in (ValueKind.POSE, ValueKind.HEIGHT) and max(map(abs, values)) > FARTHEST_SHIFT:
        message = f"`shift` of `{field.name}` is {max(map(abs, values)):g} m, more than {FARTHEST_SHIFT:g} m"
        return VaryProblem("SF104", (entry, "shift"), message, "lengths are in meters")
    movable = field.kind is ValueKind.HEIGHT or (field.kind is ValueKind.POSE and field.places[0].path[0] == "objects")
    if shift.with_contents and not movable:
        message = f"`with_contents` does not fit `{field.name}`, which is {field.kind}"
        return VaryProblem("SF107", (entry, "with_contents"), message, "use it for `object.NAME.height` or a pose")
    return None


def _missing(entry: str, distribution: AnyDistribution, field: VariedField) -> VaryProblem | None:
    """Return a problem if a distribution needs something that the twin does not state."""
    for place in field.places:
        rivals = sorted(k for k in RIVALS.get(place.path[-1], ()) if getattr(place.owner, k, None) is not None)
        if rivals and place.base is None and place.path[-1] not in ("mass", "density"):
            message = f"`{field.name}` is not stated, because the twin states `{rivals[0]}`"
            return VaryProblem("SF107", (entry,), message, f"vary `{rivals[0]}` instead")
        if isinstance(distribution, EstimateDistribution) and place.estimate is None:
            key = place.path[-1]
            hint = f"write `{key}: {{value: ..., range: [..., ...]}}` in the twin, or use `times`"
            return VaryProblem("SF201", (entry,), f"the twin states no range of an estimate for `{field.name}`", hint)
        if isinstance(distribution, _RELATIVE) and place.base is None:
            message = f"the twin states no value for `{field.name}`, to which `{_key(distribution)}` could apply"
            return VaryProblem("SF201", (entry,), message, "use `uniform`, or write the value in the twin")
        if isinstance(distribution, FactorDistribution) and place.base == 0:
            message = f"`{field.name}` is 0 in the twin, and `times` does not change it"
            return VaryProblem("SF107", (entry, "times"), message, "use `uniform`, or write another value in the twin")
    absolute = (UniformDistribution, LogUniformDistribution)
    if field.places[0].path[-1] in ("mass", "inertia") and len(field.places) > 1 and isinstance(distribution, absolute):
        message = f"`{field.object}` has {len(field.places)} links, which cannot all have the same mass"
        return VaryProblem("SF107", (entry,), message, f"use `times`, or `object.{field.object}.asset.links.LINK.mass`")
    return None


# -- bounds ------------------------------------------------------------------------------------------------------------


def _bounded(
    entry: str, distribution: AnyDistribution, field: VariedField, choices: Mapping[str, Any]
) -> tuple[VariedField, VaryProblem | None]:
    """Return a field whose ends are the range of the distribution at each place, or a problem if values are invalid."""
    if choices:
        if field.kind in (ValueKind.FILE, ValueKind.BACKGROUND):
            return field, None
        for k, value in enumerate(choices.values()):
            for place in field.places:
                if wrong := _rejected(place, value, field):
                    return field, VaryProblem("SF104", (entry, "choose", k), wrong)
        return field, None
    if field.kind is ValueKind.VECTOR:
        return field, _vector_problem(entry, distribution, field)
    if field.kind not in (ValueKind.NUMBER, ValueKind.JOINT):
        return field, None
    places = []
    for place in field.places:
        ends = range_of(distribution, place.base, place.estimate)
        assert ends is not None
        low, high = place.ends
        if isinstance(distribution, NormalDistribution | NormalAngleDistribution):
            ends = max(ends[0], min(low, place.base)), min(ends[1], max(high, place.base))
        elif not (low <= ends[0] and ends[1] <= high):
            bound = f"at least {low:.6g}" if ends[0] < low else f"at most {high:.6g}"
            message = f"`{field.name}` would be between {ends[0]:.6g} and {ends[1]:.6g}, but it must be {bound}"
            return field, VaryProblem("SF104", (entry, _key(distribution)), message, "narrow the range")
        for value in ends:
            if wrong := _rejected(place, round(value) if field.whole else value, field):
                return field, VaryProblem("SF104", (entry, _key(distribution)), wrong)
        places.append(replace(place, ends=ends))
    return replace(field, places=tuple(places)), None


def _vector_problem(entry: str, distribution: AnyDistribution, field: VariedField) -> VaryProblem | None:
    base = field.places[0].base
    if isinstance(distribution, ConeDistribution):
        if math.hypot(*base) < 1e-9:  # as far from zero as a direction must be in documents
            return VaryProblem("SF107", (entry, "cone_deg"), f"`{field.name}` is zero, so it has no direction")
        return None
    corners: list[tuple[float, ...]] = []
    if isinstance(distribution, FactorDistribution):
        corners = [tuple(v * factor for v in base) for factor in distribution.times]
    elif isinstance(distribution, ShiftDistribution) and distribution.shift is not None:
        reach = distribution.shift if isinstance(distribution.shift, tuple) else (distribution.shift,) * 3
        corners = [tuple(v + sign * r for v, r in zip(base, reach, strict=True)) for sign in (-1, 1)]
    for corner in corners:
        if wrong := _rejected(field.places[0], corner, field):
            return VaryProblem("SF104", (entry, _key(distribution)), wrong)
    return None


def _rejected(place: VariedPlace, value: Any, field: VariedField) -> str:
    """Return why the model of a place does not accept a value, or an empty text if it does."""
    owner, key = place.owner, place.path[-1]
    if not isinstance(owner, Model) or key not in type(owner).model_fields:
        low, high = place.ends
        fits = not isinstance(value, float | int) or (math.isfinite(value) and low <= value <= high)
        return "" if fits else f"`{field.name}` must be between {low:.6g} and {high:.6g}, not {value:.6g}"
    data = {name: getattr(owner, name) for name in owner.model_fields_set - RIVALS.get(key, set())}
    try:
        type(owner).model_validate({**data, key: value})
    except ValidationError as error:
        shown = f"{value:.6g}" if isinstance(value, float) else f"{value}"
        reason = error.errors()[0]["msg"]
        return f"`{field.name}` cannot be {shown}: {reason[:1].lower()}{reason[1:]}"
    return ""


# -- entries together --------------------------------------------------------------------------------------------------


def _once(values: list[VariedValue]) -> tuple[list[VariedValue], list[VaryProblem]]:
    """Return the values without those of patterns for which another entry has the exact path, and the conflicts."""
    exact = {value.field.name for value in values if "*" not in value.entry}
    kept = [value for value in values if "*" not in value.entry or value.field.name not in exact]
    problems: list[VaryProblem] = []
    taken: dict[tuple[str, tuple[str, ...]], VariedValue] = {}
    for value in kept:
        for place in value.field.places:
            clash = next(_clashing(taken, place), None)
            if clash is not None and clash.entry != value.entry:
                message = f"`{value.entry}` and `{clash.entry}` both vary `{value.field.name}`"
                if clash.field.name != value.field.name:
                    message = f"`{value.field.name}` and `{clash.field.name}` cannot both vary"
                hint = "keep one of them; an entry without `*` takes precedence over patterns"
                problems.append(VaryProblem("SF107", (value.entry,), message, hint))
                break
            taken[place.document, place.path] = value
    return kept, list(dict.fromkeys(problems))


def _clashing(taken: Mapping[tuple[str, tuple[str, ...]], VariedValue], place: VariedPlace) -> Iterator[VariedValue]:
    """Yield the values that exclude a place: those at the same path, above it, and those of rival keys."""
    *above, key = place.path
    for end in range(1, len(place.path) + 1):
        if (value := taken.get((place.document, place.path[:end]))) is not None:
            yield value
    for rival in sorted(RIVALS.get(key, ())):
        if (value := taken.get((place.document, (*above, rival)))) is not None:
            yield value
    for (document, path), value in taken.items():
        if document == place.document and path[: len(place.path)] == place.path:
            yield value


def _axis_problems(spec: CousinsSpec, values: list[VariedValue]) -> Iterator[VaryProblem]:
    """Yield conflicts with the other axes of a recipe."""
    moved = spec.scene.objects if spec.scene is not None else {}
    replaced = spec.object.objects if spec.object is not None else {}
    for value in values:
        field = value.field
        if field.effect == "instruction" and spec.task is not None:
            message = "`instruction` cannot vary, because the axis `task` writes an instruction for each task"
            yield VaryProblem("SF107", (value.entry,), message, "remove one of them")
        if field.kind in (ValueKind.POSE, ValueKind.HEIGHT) and field.object in moved and _is_object(field):
            message = f"`{field.name}` cannot vary, because the axis `scene` places `{field.object}`"
            yield VaryProblem("SF107", (value.entry,), message, "remove one of them")
        if field.places[0].path[-1] == "asset" and field.object in replaced:
            message = f"`{field.name}` cannot vary, because the axis `object` replaces `{field.object}`"
            yield VaryProblem("SF107", (value.entry,), message, "remove one of them")


def _is_object(field: VariedField) -> bool:
    return field.places[0].path[0] == "objects"


def _split_problems(spec: CousinsSpec, entry: str, values: list[VariedValue]) -> list[VaryProblem]:
    count, splits = min((len(value.choices) for value in values if value.choices), default=0), len(spec.splits)
    if not count or count >= splits:
        return []
    message = f"{splits} splits cannot share {count} value{'s' if count > 1 else ''}: each needs one of its own"
    return [VaryProblem("SF105", (entry, "choose"), message, "add values, or remove splits")]
