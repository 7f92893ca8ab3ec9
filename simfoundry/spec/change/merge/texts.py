"""Merge the texts of three documents, and resolve recorded conflicts."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

from simfoundry.errors import SimfoundryError
from simfoundry.spec.change.diff.changes import Rename, copied, renamed
from simfoundry.spec.change.merge.conflict import ABSENT, CONFLICTS, MergeConflict, Path_, dotted, parts
from simfoundry.spec.change.merge.equality import identical
from simfoundry.spec.change.merge.members import reordered, rivals_at
from simfoundry.spec.change.merge.trees import merge_trees, model_in
from simfoundry.spec.diagnostics import Diagnostic, Severity, SpecError
from simfoundry.spec.models.base import Model
from simfoundry.spec.yaml.nodes import YamlError
from simfoundry.spec.yaml.text import parse
from simfoundry.spec.yaml.tree import KIND, YamlTree, read_tree, with_data
from simfoundry.spec.yaml.write import write_tree

# Codes of findings in texts that are not documents.
_UNREADABLE = ("SF002", "SF004", "SF005")


class UnmergeableError(SimfoundryError):
    """Raised if the texts are not documents of the same kind and can only be merged line by line."""


@dataclass(frozen=True)
class MergedText:
    """A merged document in which the unresolved conflicts are recorded."""

    text: str
    conflicts: tuple[MergeConflict, ...]


def merge_texts(base: str, ours: str, theirs: str) -> MergedText:
    """Merge three texts semantically, including their comments.

    If one side already equals the result, its text is returned unchanged. Otherwise, the result is in canonical form.
    If both sides added the document, ``base`` is empty.

    Raises:
        UnmergeableError: If a text is not a document, or if the documents are of different kinds.
    """
    trees = [_tree(text, name) for text, name in ((base, "base"), (ours, "ours"), (theirs, "theirs"))]
    kinds = {str(tree.value[KIND].data) for tree in trees if KIND in tree.value}
    if len(kinds) > 1:
        raise UnmergeableError(f"the documents are of different kinds: {', '.join(sorted(kinds))}")
    merged = merge_trees(*trees)
    for text, tree in ((ours, trees[1]), (theirs, trees[2])):
        if identical(merged.tree, tree):
            return MergedText(text, merged.conflicts)
    return MergedText(write_tree(merged.tree, model_in(merged.tree)), merged.conflicts)


def new_errors(path: Path, merged: str, ours: str, theirs: str) -> list[Diagnostic]:
    """Return the errors in a merged text at ``path`` that occur on neither side.

    These errors mean that the edits are incompatible. Unresolved conflicts are excluded. A missing file that the other
    side adds is not reported, because that side's text has the same error.

    Raises:
        UnmergeableError: If the merged text could not be read, for example because it is too large.
    """
    found = _errors(path, merged)
    if not found:
        return []
    for d in found:
        if d.code in _UNREADABLE:
            raise UnmergeableError(f"the merged text could not be parsed: {d.message}")
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
    except (YamlError, SpecError) as error:
        first = error.diagnostics[0] if isinstance(error, SpecError) else error
        raise UnmergeableError(f"{name} could not be parsed: line {first.line}: {first.message}") from None
    if not isinstance(tree.value, dict):
        raise UnmergeableError(f"{name} is not a document")
    return tree


Side = Literal["ours", "theirs"]


class ResolveError(SimfoundryError):
    """Raised if a conflict is not recorded or its path no longer exists."""


def resolve(
    tree: YamlTree, model: type[Model] | None, side: Side, chosen: Iterable[str] = ()
) -> tuple[YamlTree, list[str]]:
    """Resolve conflicts by taking the values from one side.

    Args:
        tree: The document.
        model: The model of the document.
        side: The side whose values are taken.
        chosen: Keys from ``conflicts``, or parent paths such as `objects.cup`; by default, all conflicts are resolved.
            Mutually exclusive keys are resolved together.

    Returns:
        The document, and the keys of the conflicts that were resolved.
    """
    data = copied(tree.data)
    entries = data.get(CONFLICTS) if isinstance(data, dict) else None
    if not isinstance(entries, dict) or not entries:
        raise ResolveError("no conflicts are recorded in this document")
    keys = _chosen(entries, model, list(chosen))
    names = dict[tuple[Path_, str], str]()
    for key in keys:
        path, entry = parts(key), entries[key]
        if not isinstance(entry, dict) or not path:
            raise ResolveError(f"`{key}` is not a valid conflict entry")
        _take(data, path, entry, entry.get(side, ABSENT), names)
        if side == "theirs":
            comment = tree.value[CONFLICTS].value[key].beside
            tree = _edited(tree, path, partial(replace, beside=comment)) if comment else tree
        del entries[key]
    data[CONFLICTS] = {_under_new_name(key, names): entry for key, entry in entries.items()}
    if not entries:
        del data[CONFLICTS]
    renames = [Rename(section, old, new) for (section, old), new in names.items()]
    return with_data(_with_new_names(tree, renames), renamed(data, renames) if renames else data), keys


def _chosen(entries: Mapping[str, Any], model: type[Model] | None, chosen: list[str]) -> list[str]:
    if not chosen:
        return list(entries)
    found = set[str]()
    for wanted in chosen:
        path = parts(wanted)
        inside = [key for key in entries if key == wanted or parts(key)[: len(path)] == path]
        if not inside:
            listed = ", ".join(f"`{key}`" for key in entries)
            raise ResolveError(f"no conflict is recorded at `{wanted}`; recorded conflicts: {listed}")
        for key in inside:
            rivals = rivals_at(model, parts(key))
            found |= {key, *(other for other in entries if parts(other) in rivals)}
    return [key for key in entries if key in found]


def _take(data: Any, path: Path_, entry: Mapping[str, Any], value: Any, names: dict[tuple[Path_, str], str]) -> None:
    """Set the value at ``path`` to one side's value."""
    place = data
    for k, part in enumerate(path[:-1]):
        place = place.get(part) if isinstance(place, dict) else None
        if not isinstance(place, dict):
            raise ResolveError(f"`{dotted(path[: k + 1])}` no longer exists; remove the entry `{dotted(path)}`")
    key, here = path[-1], entry.get("ours")
    if value is ABSENT:
        place.pop(key, None)
    elif isinstance(place.get(key), dict) and _is_order(value, place[key]):
        place[key] = {name: place[key][name] for name in reordered(place[key], value)}
    elif key not in place and entry.get("base") == key and isinstance(here, str) and here in place:
        if value in place and value != here:
            raise ResolveError(f"`{dotted((*path[:-1], value))}` already exists; rename one of the two by hand")
        names[path[:-1], here] = value  # both sides renamed the member at `path`
    else:
        place[key] = value


def _is_order(value: Any, members: Mapping[str, Any]) -> bool:
    """Return True if a value specifies an order of keys rather than a new value for the mapping."""
    names = value if isinstance(value, tuple) and all(isinstance(name, str) for name in value) else ()
    return any(name in members for name in names)


def _under_new_name(key: str, names: Mapping[tuple[Path_, str], str]) -> str:
    """Return the key of a remaining conflict entry, updated if the member was renamed."""
    path = parts(key)
    for (section, old), new in names.items():
        if path[: len(section) + 1] == (*section, old):
            return dotted((*section, new, *path[len(section) + 1 :]))
    return key


def _with_new_names(tree: YamlTree, renames: Iterable[Rename]) -> YamlTree:
    """Return the tree with its members renamed and their comments preserved."""
    for rename in renames:

        def with_new(members: YamlTree, old: str = rename.old, new: str = rename.new) -> YamlTree:
            return replace(members, value={new if key == old else key: child for key, child in members.value.items()})

        tree = _edited(tree, rename.section, with_new)
    return tree


def _edited(tree: YamlTree, path: Path_, edit: Callable[[YamlTree], YamlTree]) -> YamlTree:
    """Return the tree with ``edit`` applied to the value at ``path``, if the value exists."""
    if not path:
        return edit(tree)
    if not isinstance(tree.value, dict) or path[0] not in tree.value:
        return tree
    return replace(tree, value={**tree.value, path[0]: _edited(tree.value[path[0]], path[1:], edit)})
