"""Variants of an object."""

from __future__ import annotations

from typing import Any

from simfoundry.spec.compose import EXCLUSIVE
from simfoundry.spec.files import is_document
from simfoundry.spec.models.base import BodySpec
from simfoundry.spec.models.scene import DEFAULT_VARIANT, ObjectSpec

GEOMETRY = ("shape", "asset")
OF_GEOMETRY = ("scale", "visual")
"""Fields that belong to a shape or mesh and are dropped when it is replaced."""


def variant_of(item: ObjectSpec, name: str) -> ObjectSpec:
    """Return the variant ``name`` of an object, without further variants; ``default`` is the object as written.

    Raises :class:`pydantic.ValidationError` if object and variant are incompatible, such as a `scale` for a primitive.
    """
    given: dict[str, Any] = {key: getattr(item, key) for key in item.model_fields_set - {"variant", "variants"}}
    if name != DEFAULT_VARIANT:
        over = item.variants[name]
        changes = {key: getattr(over, key) for key in over.model_fields_set}
        dropped = {rival for group in EXCLUSIVE for key in group if key in changes for rival in group} - changes.keys()
        if any(key in changes for key in GEOMETRY):
            dropped |= {*OF_GEOMETRY, "joints"} - changes.keys()
        if over.asset is not None and is_document(over.asset):  # its links define mass and material themselves
            dropped |= BodySpec.model_fields.keys() - changes.keys()
        given = {key: value for key, value in given.items() if key not in dropped} | changes
    return ObjectSpec(**given)


def variant_names(item: ObjectSpec) -> list[str]:
    """Return the names of all variants of an object, ``default`` first; empty if it has none."""
    return [DEFAULT_VARIANT, *item.variants] if item.variants else []
