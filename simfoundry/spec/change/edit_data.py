"""Edits of documents as values at paths, and the text that a document has after them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from simfoundry.spec.change.edit_text import edit_text, parsed_once
from simfoundry.spec.change.flatten import own_data
from simfoundry.spec.change.merge.conflict import ABSENT
from simfoundry.spec.compose.compose import inherited_data
from simfoundry.spec.files import Loaded
from simfoundry.spec.models.base import Model
from simfoundry.spec.models.kinds import model_of
from simfoundry.spec.models.types import models_at
from simfoundry.spec.yaml.text import Read, read

# A path in the data of a document, such as ``("objects", "mug")``.
DataPath = tuple[str, ...]

# Values by path; :data:`ABSENT` removes the value at a path.
DataEdits = Mapping[DataPath, Any]


def is_member(model: type[Model], path: DataPath) -> bool:
    """Return True if a path ends with the name of a member, such as an object, and False if it ends with a field."""
    return not any(path[-1] in owner.model_fields for owner in models_at(model, path[:-1]))


def with_value(model: type[Model], data: dict[str, Any], path: DataPath, value: Any, depth: int = 1) -> dict[str, Any]:
    """Return a copy of ``data`` with a new value at a path. The original data is not modified.

    If the value is :data:`ABSENT`, the key is removed, and so are fields and sections that become empty as a result.
    Named members, such as objects, are kept even if they become empty.
    """
    part, new = path[depth - 1], value
    if depth < len(path):
        below = data.get(part)
        new = with_value(model, below if isinstance(below, dict) else {}, path, value, depth + 1)
    if new is ABSENT or (value is ABSENT and not new and not is_member(model, path[:depth])):
        return {key: item for key, item in data.items() if key != part}
    return {**data, part: new}


def edited_text(loaded: Loaded, edits: DataEdits, reader: Read = read) -> str:
    """Return the text of a document after edits of its composed content.

    What the document inherits, or what is written out from repeats, includes and templates, becomes an entry of its own
    where an edit changes it. Everything else in the text stays as it is, including comments and layout.

    Args:
        loaded: The document. Its text must have been parsed and composed; other errors do not matter.
        edits: Values as plain data (mappings, tuples and scalars).
        reader: Function that reads the document that it extends.
    """
    assert loaded.source is not None and loaded.document is not None
    kind = str(loaded.source.data.get("simfoundry"))
    model = model_of(kind)
    before = loaded.document.data
    after = before
    for path, value in edits.items():
        after = with_value(model, after, path, value)
    written = parsed_once(loaded.source.text).data  # joining a document with others may have changed its nodes
    own = own_data(written, before, after, inherited_data(loaded, kind, loaded.root, reader))
    return edit_text(loaded.source.text, own, model)
