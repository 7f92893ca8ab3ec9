"""The meaning of a key: the words of the reference and of the JSON schemas, for a place in a document."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

from pydantic import BaseModel

from simfoundry.spec.editor import snippets
from simfoundry.spec.editor.reference import default_text, type_text
from simfoundry.spec.editor.schema import Schema
from simfoundry.spec.editor.snippets import title
from simfoundry.spec.models.kinds import model_of
from simfoundry.spec.models.types import former_keys, models_at

# Link to a table of the reference page.
_LINK = re.compile(r"\[([^\]]*)\]\(#[^)]*\)")


@dataclass(frozen=True)
class KeyMeaning:
    """The meaning of a key.

    Attributes:
        key: The key.
        owner: What the key belongs to, such as ``camera``.
        text: The meaning, with the unit.
        type: The type and the limits of the value, such as ``number > 0``.
        default: The default value, or an empty string if there is none.
        required: True if the key must be written.
    """

    key: str
    owner: str
    text: str
    type: str
    default: str
    required: bool


def key_meaning(kind: str, path: Sequence[str | int]) -> KeyMeaning | None:
    """Return the meaning of the last key in a path, or None if it is a name or unknown.

    Args:
        kind: Kind of the document, such as ``scene/1``.
        path: Keys and indices from the top of the document.
    """
    if not path or not isinstance(path[-1], str):
        return None
    for model in models_at(model_of(kind), tuple(path[:-1])):
        key = former_keys(model).get(path[-1], path[-1])
        if key in model.model_fields:
            return _meaning(model, key)
    return None


@cache
def _meaning(model: type[BaseModel], key: str) -> KeyMeaning:
    whole = _schema(model)
    field: Schema = whole["properties"][key]
    default = default_text(field.get("default"))
    return KeyMeaning(
        key,
        title(model.__name__),
        _text(model, key, field, whole),
        _LINK.sub(r"\1", type_text(field)),
        "" if default == "–" else default,
        key in whole.get("required", ()),
    )


def _text(model: type[BaseModel], key: str, field: Schema, whole: Schema) -> str:
    """Return the description of a key, or the description of its value if the key has none."""
    said: Any = field.get("description") or snippets.lookup("descriptions", f"{model.__name__}.{key}")
    if not said and "$ref" in field:
        said = whole["$defs"][field["$ref"].rpartition("/")[2]].get("description")
    if model.__name__.endswith("Shape") and said != whole["description"]:
        return f"{whole['description']} {said or ''}".strip()  # a shape is described with its only key
    return str(said or "")


@cache
def _schema(model: type[BaseModel]) -> Schema:
    """Return the schema of a model. Models that contain themselves are resolved."""
    found = model.model_json_schema()
    return found if "properties" in found else {**found, **found["$defs"][found["$ref"].rpartition("/")[2]]}
