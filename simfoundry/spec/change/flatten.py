"""Flatten documents: merge a document with the documents that it extends, and write out all default values.

The inverse, :func:`own_data`, determines what a document must contain if its merged content is edited.
"""

from __future__ import annotations

import hashlib
import os
from pathlib import Path, PurePosixPath
from typing import Any

from simfoundry.spec.change.diff.changes import copied, same
from simfoundry.spec.change.merge.conflict import ABSENT
from simfoundry.spec.models.base import DocumentSpec, Model
from simfoundry.spec.models.scene import VariantSpec
from simfoundry.spec.models.types import RIVALS, Pattern, field_order, file_patterns
from simfoundry.spec.yaml.tree import plain_tree
from simfoundry.spec.yaml.write import to_data, write_tree


def flatten(spec: DocumentSpec, folder: Path | None = None, into: Path | None = None) -> str:
    """Return the canonical text of a document, including all default values.

    Fields with derived values, such as a friction coefficient defined by the material, are omitted. Flattening is
    idempotent.

    Args:
        spec: The document, merged with the documents that it extends.
        folder: The folder that file references in the document are relative to.
        into: The folder that file references in the result are relative to; defaults to ``folder``.
    """
    data = full(spec)
    data.pop("extends", None)
    if folder is not None and into is not None:
        data = relocated(data, type(spec), folder, into)
    return write_tree(plain_tree(data), type(spec))


def relocated(data: dict[str, Any], model: type[Model], folder: Path, into: Path) -> dict[str, Any]:
    """Return the data of a document with file references relative to ``into`` instead of ``folder``."""
    if folder.resolve() != into.resolve():
        step = PurePosixPath(Path(os.path.relpath(folder.resolve(), into.resolve())).as_posix())
        for pattern in file_patterns(model):
            data = _moved(data, pattern, step)
    return data


def digest(text: str) -> str:
    """Return the SHA-256 hex digest of a flattened text. The digest does not depend on the document's formatting."""
    return hashlib.sha256(text.encode()).hexdigest()


def full(spec: Model) -> dict[str, Any]:
    """Return the plain data of a document or a part of one, including defaults, in canonical order."""
    given = {name for name in spec.model_fields_set if getattr(spec, name) is not None}
    out: dict[str, Any] = {}
    for name in field_order(type(spec)):
        value = getattr(spec, name)
        rivals = RIVALS.get(name, set())
        if value is None or (name not in given and (rivals & given or (isinstance(value, dict | tuple) and not value))):
            continue
        out[name] = copied(value, _full_member)
    return out


def _full_member(item: Any) -> Any:
    """Return a part of a document including its defaults. A variant has none: it inherits what it does not state."""
    if isinstance(item, VariantSpec):
        return to_data(item)
    return full(item) if isinstance(item, Model) else item


def own_data(own: Any, before: Any, after: Any, base: Any = ABSENT) -> Any:
    """Return the data that a document must contain for its merged content to change from ``before`` to ``after``.

    Members of the base document that ``after`` does not contain are set to null, which removes them.

    Args:
        own: The document's current data, or :data:`ABSENT`.
        before: The current data after merging with the base document.
        after: The desired data after merging with the base document.
        base: The data of the base document, or :data:`ABSENT`.
    """
    if same(before, after):
        return own
    if after is ABSENT:
        return ABSENT if base is ABSENT else None
    if isinstance(after, tuple) and isinstance(own, tuple) and isinstance(before, tuple):
        if len(own) == len(before) == len(after):  # a component that stays may be written as an expression
            return tuple(mine if same(old, new) else new for mine, old, new in zip(own, before, after, strict=True))
        return after
    if not isinstance(after, dict) or not (isinstance(own, dict) or isinstance(base, dict)):
        return after
    mine, inherited = (side if isinstance(side, dict) else {} for side in (own, base))
    current = before if isinstance(before, dict) else inherited
    kept = {}
    for key in dict.fromkeys((*mine, *current, *after, *inherited)):
        value = own_data(*(side.get(key, ABSENT) for side in (mine, current, after, inherited)))
        if value is ABSENT and key in inherited.keys() - after.keys() and not RIVALS.get(key, set()) & after.keys():
            value = None  # a key of this document that excluded `key` was removed, so `key` would be inherited again
        if value is not ABSENT:
            kept[key] = value
    return kept if kept or not isinstance(base, dict) else ABSENT


def _moved(data: Any, pattern: Pattern, step: PurePosixPath) -> Any:
    """Return the data with the file references at ``pattern`` rewritten relative to another folder."""
    if not pattern:
        stays = not isinstance(data, str) or ":" in data or data.startswith("/")
        return data if stays else os.path.normpath(step / data)
    if isinstance(data, dict):
        keys = list(data) if pattern[0] == "*" else [k for k in data if k == pattern[0]]
        return {key: _moved(item, pattern[1:], step) if key in keys else item for key, item in data.items()}
    if isinstance(data, tuple) and pattern[0] == "*":
        return tuple(_moved(item, pattern[1:], step) for item in data)
    return data
