"""Merge the texts of three documents."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from simfoundry.errors import SimfoundryError
from simfoundry.spec.change.merge.conflict import MergeConflict
from simfoundry.spec.change.merge.equality import identical
from simfoundry.spec.change.merge.trees import merge_trees
from simfoundry.spec.diagnostics import Diagnostic, Severity, SpecError
from simfoundry.spec.models.kinds import KINDS, model_of
from simfoundry.spec.yaml.nodes import YamlError
from simfoundry.spec.yaml.text import parse
from simfoundry.spec.yaml.tree import KIND, YamlTree, read_tree
from simfoundry.spec.yaml.write import write_tree

_UNREADABLE = ("SF002", "SF004", "SF005")
"""Codes of texts that are not documents."""


class UnmergeableError(SimfoundryError):
    """Error for texts that are not documents of the same kind and can only be merged line by line."""


@dataclass(frozen=True)
class MergedText:
    """Merged document in which the open conflicts are recorded."""

    text: str
    conflicts: tuple[MergeConflict, ...]


def merge_texts(base: str, ours: str, theirs: str) -> MergedText:
    """Merge three texts by meaning, comments included; ``base`` is empty if both sides added the document.

    If one side already equals the result, its text is returned unchanged; otherwise the result is in canonical form.
    Raises :class:`UnmergeableError` if a text is not a document or the documents are of different kinds.
    """
    trees = [_tree(text, name) for text, name in ((base, "base"), (ours, "ours"), (theirs, "theirs"))]
    kinds = {str(tree.value[KIND].data) for tree in trees if KIND in tree.value}
    if len(kinds) > 1:
        raise UnmergeableError(f"these are documents of different kinds: {', '.join(sorted(kinds))}")
    merged = merge_trees(*trees)
    for text, tree in ((ours, trees[1]), (theirs, trees[2])):
        if identical(merged.tree, tree):
            return MergedText(text, merged.conflicts)
    kind = next(iter(kinds), "")
    return MergedText(write_tree(merged.tree, model_of(kind) if kind in KINDS else None), merged.conflicts)


def new_errors(path: Path, merged: str, ours: str, theirs: str) -> list[Diagnostic]:
    """Return errors of a merged text at ``path`` that neither side has, which means that the edits are incompatible.

    Open conflicts are excluded. Missing files that the other side adds are not reported, because they are missing for
    its own text as well. Raises :class:`UnmergeableError` if the merged text cannot be read, for example because it is
    too large.
    """
    found = _errors(path, merged)
    if not found:
        return []
    for d in found:
        if d.code in _UNREADABLE:
            raise UnmergeableError(f"the merged text cannot be read: {d.message}")
    known = {(d.code, d.path, d.message) for text in (ours, theirs) for d in _errors(path, text)}
    return [d for d in found if (d.code, d.path, d.message) not in known]


def _errors(path: Path, text: str) -> list[Diagnostic]:
    from simfoundry.spec.load import load

    findings = load(path, text=text).findings
    return [d for d in findings if d.severity is Severity.ERROR and d.code != "SF209"]


def _tree(text: str, name: str) -> YamlTree:
    try:
        document = parse(text, name)
        if document.data is None and name == "base":
            return YamlTree({})
        tree = read_tree(document)
    except YamlError as error:
        raise UnmergeableError(f"{name} cannot be read: line {error.line}: {error.message}") from None
    except SpecError as error:
        first = error.diagnostics[0]
        raise UnmergeableError(f"{name} cannot be read: line {first.line}: {first.message}") from None
    if not isinstance(tree.value, dict):
        raise UnmergeableError(f"{name} is not a document")
    return tree
