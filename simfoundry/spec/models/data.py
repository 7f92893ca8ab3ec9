"""Convert typed documents to plain data without defaults."""

from __future__ import annotations

from functools import cache
from typing import Any

from simfoundry.spec.models.base import Model
from simfoundry.spec.models.order import field_order
from simfoundry.spec.yaml.spelling import rounded


def to_data(spec: Model) -> dict[str, Any]:
    """Return the plain data of a document in canonical order, without values that equal their defaults."""
    out: dict[str, Any] = {}
    given = spec.model_fields_set
    for name, needed, default in _fields(type(spec)):
        if not needed and name not in given:
            continue
        data = _data(getattr(spec, name))
        # A value with the same text as the default would be read as the default and then not be written again.
        if needed or not _written_alike(data, default):
            out[name] = data
    return out


@cache
def _fields(model: type[Model]) -> tuple[tuple[str, bool, Any], ...]:
    """Return the name, whether it is required, and the default of each field, in canonical order."""
    fields = model.model_fields
    needed = {name for name, info in fields.items() if name == "simfoundry" or info.is_required()}
    return tuple((name, name in needed, _data(fields[name].default)) for name in field_order(model))


_SCALARS = (str, float, int, type(None))


def _data(value: Any) -> Any:
    if isinstance(value, _SCALARS):
        return value
    match value:
        case Model():
            return to_data(value)
        case dict():
            return {key: _data(item) for key, item in value.items()}
        case tuple():
            return tuple([_data(item) for item in value])
    return value


def _written_alike(a: Any, b: Any) -> bool:
    """Return True if two values have the same text, where numbers are written with six decimals."""
    match a, b:
        case (float(), float() | int()) | (int(), float()):
            return rounded(a) == rounded(b)
        case tuple(), tuple():
            return len(a) == len(b) and all(map(_written_alike, a, b))
        case dict(), dict():
            return a.keys() == b.keys() and all(_written_alike(value, b[key]) for key, value in a.items())
    return bool(a == b)
