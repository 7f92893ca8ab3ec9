"""Write edits of a stage into the text of its document, preserving comments, order and overlays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from simfoundry.frontends.usd.compiled.edits import differs
from simfoundry.frontends.usd.compiled.references import renamed
from simfoundry.spec.diagnostics import SpecError
from simfoundry.spec.load import compose
from simfoundry.spec.models.scene import SceneSpec
from simfoundry.spec.models.types import RIVALS, models_at
from simfoundry.spec.project import project_root
from simfoundry.spec.yaml.nodes import YamlError
from simfoundry.spec.yaml.text import read
from simfoundry.spec.yaml.tree import YamlTree, read_tree, with_data
from simfoundry.spec.yaml.write import write_tree

KIND = "scene/1"

Data = dict[str, Any]
Path_ = tuple[str, ...]
NOTHING = object()


@dataclass(frozen=True)
class Edit:
    """One changed value: old and new value, ``NOTHING`` if absent."""

    path: Path_
    old: Any
    new: Any


@dataclass(frozen=True)
class Written:
    """Document with edits applied; ``disputed`` contains the paths at which it had changed independently."""

    name: str
    text: str
    disputed: tuple[str, ...]


def edits(old: Data, new: Data, path: Path_ = ()) -> list[Edit]:
    """Return the edits that turn ``old`` into ``new``: mappings member by member, other values as a whole."""
    found: list[Edit] = []
    for key in dict.fromkeys((*old, *new)):
        a, b = old.get(key, NOTHING), new.get(key, NOTHING)
        if isinstance(a, dict) and isinstance(b, dict) and (a.keys() & b.keys() or len(path) == 0):
            found += edits(a, b, (*path, key))
        elif a is NOTHING or b is NOTHING or a != b:
            found.append(Edit((*path, key), a, b))
    return found


def written_into(path: Path, old: Data, new: Data, names: Mapping[tuple[str, str], str]) -> Written:
    """Return the text of the document at ``path`` with the changes from ``old`` to ``new``.

    ``names`` are new names by section and old name. An overlay remains an overlay: it gets only the differences, and
    ``null`` for removed values of its base. Raises :class:`SpecError` if the document cannot be read.
    """
    try:
        document = read(path)
    except YamlError as error:
        raise SpecError([error.diagnostic(str(path))]) from None
    tree = read_tree(document)
    whole, findings, bases = compose(document, KIND, project_root(path).resolve())
    if findings or not isinstance(tree.value, dict):
        raise SpecError(findings)
    base = _base(path, bases)
    own = {key: new_name for key, new_name in names.items() if _at(base, key) is NOTHING}
    todo = edits(renamed(old, own), new)
    if not todo and not own:
        return Written(str(whole.data.get("name")), document.text, ())
    if own:
        tree = _with_names(tree, own)
    present = renamed(whole.data, own)
    data, disputed = tree.data, []
    for edit in todo:
        there = _at(present, edit.path)
        if there is not NOTHING and there != edit.new and _other(there, edit.old):
            disputed.append(".".join(edit.path))
        data = _applied(data, base, (), edit.path, edit.new)
    text = write_tree(with_data(tree, data), SceneSpec)
    return Written(str(whole.data.get("name")), text, tuple(disputed))


def _base(path: Path, bases: list[Path]) -> Data:
    """Return the flattened base of the document at ``path``; empty if it extends nothing."""
    if not bases:
        return {}
    from simfoundry.spec.load import load

    loaded = load(bases[0], project_root(path))
    return loaded.document.data if loaded.document is not None else {}


def _other(there: Any, old: Any) -> bool:
    """Return True if a document differs from its compiled content."""
    if old is NOTHING:
        return True
    if isinstance(there, dict) and isinstance(old, dict):
        return any(_other(there[key], old.get(key, NOTHING)) for key in there if key in old)
    return differs(there, old)


def _at(data: Any, path: Path_) -> Any:
    for key in path:
        if not isinstance(data, dict) or key not in data:
            return NOTHING
        data = data[key]
    return data


def _applied(data: Data, base: Any, above: Path_, path: Path_, value: Any) -> Data:
    """Return the data at ``above`` of a document, which may extend ``base`` there, with ``value`` at ``path`` below."""
    key, below = path[0], path[1:]
    inherited = base.get(key, NOTHING) if isinstance(base, dict) else NOTHING
    out = dict(data)
    rivals = _rivals(key, above)
    if below:
        inside = out.get(key)
        child = _applied(inside if isinstance(inside, dict) else {}, inherited, (*above, key), below, value)
        if child:
            out[key] = child
        else:
            out.pop(key, None)
    elif value is NOTHING:
        out.pop(key, None)
        if inherited is not NOTHING and not any(out.get(rival) is not None for rival in rivals):
            out[key] = None
    else:
        out = {k: v for k, v in out.items() if k not in rivals and (k != key or value != inherited)}
        if value != inherited:
            out[key] = value
    return out


def _rivals(key: str, above: Path_) -> set[str]:
    """Return the keys that ``key`` replaces; empty for a named mapping."""
    rivals = RIVALS.get(key, set())
    return rivals if rivals and models_at(SceneSpec, above) else set()


def _with_names(tree: YamlTree, names: Mapping[tuple[str, str], str]) -> YamlTree:
    """Return the tree with renamed members, each with its comments."""
    sections = {}
    for section, child in tree.value.items():
        if isinstance(child.value, dict):
            value = {names.get((section, name), name): member for name, member in child.value.items()}
            child = replace(child, value=value)
        sections[section] = child
    tree = replace(tree, value=sections)
    return with_data(tree, renamed(tree.data, names))
