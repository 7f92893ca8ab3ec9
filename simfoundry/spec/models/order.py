"""Canonical order of keys: the most important keys first, then the order of the models."""

from __future__ import annotations

import functools
import typing
from collections.abc import Iterable
from typing import Any

from simfoundry.spec.models.base import BodySpec, DocumentSpec, Model
from simfoundry.spec.models.types import flat

_FIRST = (
    "simfoundry",
    "extends",
    "name",
    "description",
    "category",
    "labels",
    "fixed",
    "shape",
    "asset",
    "mesh",
    "scale",
    "visual",
    "material",
    "color",
    "mass",
    "density",
    "friction",
    "restitution",
    "collision",
    "solid",
    "pose",
    "place",
)
"""Most important fields of bodies and documents, which come first; the others follow in the order of their model."""
_LAST = ("allow", "conflicts")
"""Fields that come last."""
_RANK = {name: rank - len(_FIRST) for rank, name in enumerate(_FIRST)} | dict.fromkeys(_LAST, 1)


def field_order(model: type[Model]) -> list[str]:
    """Return the names of a model's fields in the order in which they are written.

    This is the order of the model, except for bodies and whole documents, whose models begin with inherited fields.
    """
    if not issubclass(model, BodySpec | DocumentSpec):
        return list(model.model_fields)
    return sorted(model.model_fields, key=lambda name: _RANK.get(name, 0))


class KeyOrder:
    """Order of the keys at and below a path in a document."""

    def __init__(self, *types_: Any) -> None:
        kinds = [kind for type_ in types_ for _, kind in flat(type_)]
        self._fields: dict[str, Any] = {}
        for model in (k for k in kinds if isinstance(k, type) and issubclass(k, Model)):
            for name in field_order(model):
                info = model.model_fields[name]
                self._fields.setdefault(name, info.annotation)
        self._rank = {name: rank for rank, name in enumerate(self._fields)}
        self._others = [typing.get_args(k)[-1] for k in kinds if typing.get_origin(k) is dict]
        self._items = [t for k in kinds if typing.get_origin(k) is tuple for t in typing.get_args(k) if t is not ...]
        self._inside: dict[str, KeyOrder] = {}

    def ordered(self, keys: Iterable[str]) -> list[str]:
        """Return fields in canonical order, followed by other keys in their given order; names keep their order."""
        rank = self._rank
        return sorted(keys, key=lambda key: rank.get(key, len(rank))) if rank else list(keys)

    def member(self, key: str) -> KeyOrder:
        """Return the order of the keys below a key."""
        known = key in self._fields
        slot = self._inside.get(key if known else "")
        if slot is None:
            slot = self._inside[key if known else ""] = KeyOrder(*([self._fields[key]] if known else self._others))
        return slot

    @functools.cached_property
    def item(self) -> KeyOrder:
        """Return the order of the keys in the items of a list."""
        return KeyOrder(*self._items)


@functools.cache
def key_order(model: type[Model] | None) -> KeyOrder:
    """Return the order of a whole document."""
    return KeyOrder(model)
