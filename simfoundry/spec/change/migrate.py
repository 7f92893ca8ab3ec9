"""Migrate older documents: rename former keys and apply version migrations step by step; comments are kept."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from simfoundry.spec.diagnostics import SpecError, nearest
from simfoundry.spec.models.kinds import KINDS, model_of
from simfoundry.spec.models.types import former_paths
from simfoundry.spec.yaml.nodes import YamlError
from simfoundry.spec.yaml.text import Document, parse
from simfoundry.spec.yaml.tree import KIND, YamlTree, read_tree
from simfoundry.spec.yaml.write import write_tree


@dataclass(frozen=True)
class Migration:
    """Step that converts a document from one version of its kind to the version ``to``."""

    to: str
    change: Callable[[YamlTree], YamlTree]


STEPS: Mapping[str, Migration] = {}
"""Migration from each older kind and version, such as ``scene/1``.

Version 1 is the first version of every kind, so there are none yet. A change that alters the meaning of older files
adds a migration here. A renamed key needs no migration; its field lists the former name (``FormerKey``).
"""

_LINE_BREAK = re.compile("\r\n|[\n\r\x85\u2028\u2029]")
"""Line breaks as the parser recognizes them."""


def migrated(text: str, file: str, steps: Mapping[str, Migration] = STEPS) -> str:
    """Return the text of a document in the latest version of its kind, with current key names.

    A text that is already up to date is returned unchanged. If the version changed, the result is in canonical form.
    Raises :class:`SpecError` for an unknown kind.
    """
    document = _parsed(text, file)
    kind = _kind(document, steps)
    if kind in steps:
        tree, seen = read_tree(document), [kind]
        while kind in steps:
            step = steps[kind]
            changed = step.change(tree)
            tree = replace(changed, value={**changed.value, KIND: replace(changed.value[KIND], value=step.to)})
            kind = step.to
            if kind in seen:
                raise ValueError(f"the steps from {seen[0]} lead back to {kind}")
            seen.append(kind)
        document = _parsed(write_tree(tree, model_of(kind)), file)
    return _with_present_keys(document, kind)


def _parsed(text: str, file: str) -> Document:
    try:
        return parse(text, file)
    except YamlError as error:
        raise SpecError([error.diagnostic(file)]) from None


def _kind(document: Document, steps: Mapping[str, Migration]) -> str:
    """Return the kind that the document names; raises :class:`SpecError` if no such kind ever existed."""
    data = document.data
    kind = data.get(KIND) if isinstance(data, dict) else None
    if isinstance(kind, str) and (kind in KINDS or kind in steps):
        return kind
    versions = [*steps, *KINDS]
    message = f"`{kind}` is not a version of a document" if kind is not None else f"the key `{KIND}` is missing"
    hint = nearest(str(kind), versions) if kind is not None else "start the document with `simfoundry: scene/1`"
    raise SpecError([*document.duplicates, document.finding("SF006", (KIND,), message, hint)])


def _with_present_keys(document: Document, kind: str) -> str:
    """Rename former keys in the text, and change nothing else."""
    text = document.text
    starts = [0, *(found.end() for found in _LINE_BREAK.finditer(text))]
    edits: dict[int, tuple[str, str]] = {}
    for path, name in former_paths(model_of(kind), document.data):
        line, column = document.place(path, of_key=True)
        edits[starts[line - 1] + column - 1] = (str(path[-1]), name)
    for start, (old, new) in sorted(edits.items(), reverse=True):
        start += text[start] in "\"'"
        if text.startswith(old, start):
            text = f"{text[:start]}{new}{text[start + len(old) :]}"
    return text
