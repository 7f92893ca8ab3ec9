"""Validate data against a model."""

from __future__ import annotations

import re
from collections.abc import Collection
from typing import Any, TypeVar

from pydantic import ValidationError

from simfoundry.spec.diagnostics import Diagnostic
from simfoundry.spec.models.base import Model
from simfoundry.spec.yaml.text import Document, Path_

M = TypeVar("M", bound=Model)

# Maximum number of findings per kind of check and document, which limits the output for malicious input.
MAX_FINDINGS = 200


def validate(model: type[M], document: Document) -> tuple[M | None, list[Diagnostic]]:
    """Return the typed document and the findings. The document is None if there are errors."""
    findings = [*document.duplicates, *_without_value(model, document)]
    try:
        spec = model.model_validate(document.data)
    except ValidationError as error:
        from simfoundry.spec.check.wording import worded

        absent = {d.path for d in findings}
        wrong = worded(model, document, error)
        return None, findings + [d for d in wrong if not (d.code == "SF107" and _needs(d, absent))]
    return (None if findings else spec), findings


def _needs(finding: Diagnostic, absent: Collection[str]) -> bool:
    """Return True if a finding says that a key is needed which is present but has no value."""
    keys = re.findall("`([a-z_]+)`", finding.message) if finding.message.endswith(" is needed") else []
    return any(f"{finding.path}.{key}" in absent for key in keys)


def _without_value(model: type[Model], document: Document) -> list[Diagnostic]:
    """Return a finding for each key or item without a value. Null is allowed only to remove a value from the base."""
    found: list[Path_] = []
    todo: list[tuple[Path_, Any]] = [((), document.data)] if isinstance(document.data, dict) else []
    while todo:
        path, data = todo.pop()
        for part, value in data.items() if isinstance(data, dict) else enumerate(data):
            if value is None:
                found.append((*path, part))
            elif isinstance(value, dict | tuple) and part != "conflicts":
                todo.append(((*path, part), value))
    if not found:
        return []
    from simfoundry.spec.check.wording import missing_value

    return [missing_value(model, document, path) for path in sorted(found, key=str)[:MAX_FINDINGS]]


def sound_part(model: type[M], document: Document) -> M | None:
    """Return the valid part of a document with errors, so that the remaining checks can run on it.

    Invalid members of a section, such as an object or a relation, are omitted entirely, and other invalid values are
    omitted together with their key. Returns None if the rest is not valid either.
    """
    data = document.data
    if not isinstance(data, dict):
        return None
    try:
        return model.model_validate(data)
    except ValidationError as error:
        faulty = {e["loc"][:2] for e in error.errors(include_url=False)}
    sound: dict[str, Any] = {"name": "unnamed"} if ("name",) in faulty else {}
    for key, value in data.items():
        if isinstance(value, dict):
            value = {name: member for name, member in value.items() if (key, name) not in faulty}
        elif isinstance(value, tuple):
            value = tuple(item for k, item in enumerate(value) if (key, k) not in faulty)
        if (key,) not in faulty:
            sound[key] = value
    try:
        return model.model_validate(sound)
    except ValidationError:
        return None
