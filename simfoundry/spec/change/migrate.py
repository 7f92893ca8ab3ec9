"""Older versions of documents, brought up to date step by step; comments stay."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from simfoundry.spec.diagnostics import SpecError, nearest
from simfoundry.spec.models.kinds import KINDS, model_of
from simfoundry.spec.models.types import Pattern
from simfoundry.spec.yaml.text import Document, YamlError, parse
from simfoundry.spec.yaml.tree import KIND, CommentedTree, read_tree
from simfoundry.spec.yaml.write import write_tree


@dataclass(frozen=True)
class Migration:
    """What leads from one version of a kind to a later one: ``to`` and the ``change`` of the document."""

    to: str
    change: Callable[[CommentedTree], CommentedTree]


STEPS: Mapping[str, Migration] = {}
"""The step from each older kind and version, as ``scene/1``.

Version 1 is the first of every kind, so there is none yet: what changes the meaning of older files adds its step here.
"""


def migrated(text: str, file: str, steps: Mapping[str, Migration] = STEPS) -> str:
    """The text of a document in the newest version of its kind, canonical where a step was taken.

    A text that is up to date comes back as it is. Raises :class:`SpecError` for a kind that is not known.
    """
    try:
        document = parse(text, file)
    except YamlError as error:
        raise SpecError([error.diagnostic(file)]) from None
    kind = _kind(document, steps)
    if kind not in steps:
        return text
    tree, seen = read_tree(document), [kind]
    while kind in steps:
        step = steps[kind]
        changed = step.change(tree)
        tree = replace(changed, value={**changed.value, KIND: replace(changed.value[KIND], value=step.to)})
        kind = step.to
        if kind in seen:
            raise ValueError(f"the steps from {seen[0]} lead back to {kind}")
        seen.append(kind)
    return write_tree(tree, model_of(kind))


def _kind(document: Document, steps: Mapping[str, Migration]) -> str:
    """The kind that the document says; raises :class:`SpecError` for one that there never was."""
    data = document.data
    kind = data.get(KIND) if isinstance(data, dict) else None
    if isinstance(kind, str) and (kind in KINDS or kind in steps):
        return kind
    versions = [*steps, *KINDS]
    message = f"`{kind}` is no version of a document" if kind is not None else f"the key `{KIND}` is missing"
    hint = nearest(str(kind), versions) if kind is not None else "start the document with `simfoundry: scene/1`"
    raise SpecError([*document.duplicates, document.finding("SF006", (KIND,), message, hint)])


def renamed(tree: CommentedTree, pattern: Pattern, name: str) -> CommentedTree:
    """The tree in which the key at ``pattern`` (``*`` stands for any) is called ``name``; its comments stay with it."""
    head, *rest = pattern
    value = tree.value
    if isinstance(value, tuple):
        return replace(tree, value=tuple(renamed(item, tuple(rest), name) for item in value)) if head == "*" else tree
    if not isinstance(value, dict):
        return tree
    if not rest:
        return replace(tree, value={name if key == head else key: child for key, child in value.items()})
    hit = {key: renamed(child, tuple(rest), name) if head in ("*", key) else child for key, child in value.items()}
    return replace(tree, value=hit)
