"""Join a document with the documents that it ``extends``; every value keeps a reference to its source file."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path, PurePosixPath

from simfoundry.spec.diagnostics import Diagnostic, Severity, nearest
from simfoundry.spec.files import FileError, reachable
from simfoundry.spec.models.kinds import model_of, suffix
from simfoundry.spec.yaml.nodes import Node, YamlError
from simfoundry.spec.yaml.text import Document, Path_, read

MAX_BASES = 16
"""Largest number of documents in a chain of `extends`, which bounds the work for malicious input."""

EXCLUSIVE = (
    ("shape", "asset"),
    ("mass", "density"),
    ("pose", "place"),
    ("yaw_deg", "rpy_deg", "quat_wxyz"),
    ("look_at", "quat_wxyz"),
    ("box", "sphere", "cylinder", "capsule", "prism", "lathe"),
    ("on", "inside"),
    ("xy", "local_xy", "left_of"),
    ("xy", "local_xy", "right_of"),
    ("xy", "local_xy", "in_front_of"),
    ("xy", "local_xy", "behind"),
    ("left_of", "right_of"),
    ("in_front_of", "behind"),
    ("mesh", "splat"),
    ("shape", "mesh"),
    ("all", "any", "not"),
)
"""Groups of mutually exclusive keys; if an overlay sets one, it replaces the others of its group in the base."""

_RIVALS: dict[str, set[str]] = {
    key: {k for group in EXCLUSIVE if key in group for k in group} - {key} for key in chain.from_iterable(EXCLUSIVE)
}


def compose(document: Document, kind: str, root: Path) -> tuple[Document, list[Diagnostic], list[Path]]:
    """Return the joined document, findings, and the files that it extends, nearest first.

    If a base cannot be used, the document is returned unchanged, and a finding gives the reason.
    """
    chained, findings, bases = [document], list[Diagnostic](), list[Path]()
    path = Path(document.file)
    while "extends" in _keys(chained[-1].root):
        found = _base(chained[-1], path, kind, root, [Path(document.file), *bases])
        if isinstance(found, Diagnostic):
            return document, [*findings, found], bases
        path = Path(found.file)
        bases.append(path)
        chained.append(found)
        findings += found.duplicates
    if not bases:
        return document, findings, bases
    whole, added = chained[-1].root, dict[Path_, tuple[str, ...]]()
    for upper in reversed(chained[:-1]):
        _take_over(whole, kind, whole.file or chained[-1].file, upper.file)
        _own(upper.root, "" if upper is document else upper.file)
        joining = _Joining(kind, upper.file)
        whole = joining.join(whole, upper.root, ())
        findings += joining.findings
        added |= joining.added
    return replace(document, data=whole.value, root=whole, added=added), findings, bases


def _keys(node: Node) -> dict[str, Node]:
    return node.children if isinstance(node.children, dict) else {}


def _base(document: Document, path: Path, kind: str, root: Path, before: list[Path]) -> Document | Diagnostic:
    """Return the document that ``document`` extends, or a finding that explains why it cannot be used."""
    written = _keys(document.root)["extends"].value
    place = ("extends",)
    if not isinstance(written, str):
        return document.finding(
            "SF103", place, "expected a text, the path of a document", "write `extends: a.scene.yaml`"
        )
    try:
        target = reachable(written, path, root, (suffix(kind), ".yaml"))
    except FileError as wrong:
        return document.finding(wrong.code, place, str(wrong), wrong.hint)
    if any(target == b.resolve() for b in before):
        cycle = " extends ".join(f"`{b.name}`" for b in [*before, target])
        return document.finding("SF207", place, f"{cycle}, which is a cycle", "remove `extends` from one of them")
    if len(before) > MAX_BASES:
        return document.finding("SF005", place, f"more than {MAX_BASES} documents extend each other")
    shown = Path(os.path.normpath(path.parent / written))
    try:
        base = read(shown if shown.resolve() == target else target)
    except YamlError as error:
        return error.diagnostic(str(shown))
    found = _keys(base.root).get("simfoundry")
    if found is None or found.value != kind:
        named = f"a `{found.value}`" if found is not None else "no"
        message = f"`{written}` is {named} document, and this is a `{kind}` one"
        return document.finding("SF006", place, message, "a document extends another of its own kind")
    _own(base.root, base.file)
    return base


def _own(node: Node, file: str) -> None:
    """Mark every value with its source file."""
    todo = [node]
    while todo:
        node = todo.pop()
        if node.file == file and node.children:
            continue  # an alias that was already marked
        node.file = file
        children = node.children
        todo += children.values() if isinstance(children, dict) else children or ()


@dataclass
class _Joining:
    """State of joining the document ``file`` with its base."""

    kind: str
    file: str
    findings: list[Diagnostic] = field(default_factory=list)
    added: dict[Path_, tuple[str, ...]] = field(default_factory=dict)

    def join(self, base: Node, over: Node, path: tuple[str, ...]) -> Node:
        """Return ``base`` overridden by ``over``: mappings are joined by key, null removes, others are replaced."""
        if not isinstance(base.children, dict) or not isinstance(over.children, dict):
            return over
        children, keys = dict(base.children), dict(base.keys)
        for key, node in over.children.items():
            if node.value is None:
                if key not in children:
                    self.nothing_to_remove(over.keys[key], (*path, key), base.children)
                children.pop(key, None)
                continue
            for rival in self.rivals(key, path, children):
                if rival not in over.children:
                    del children[rival]
            if key not in base.children:
                self.added[*path, key] = tuple(base.children)
            children[key] = self.join(children[key], node, (*path, key)) if key in children else node
            keys[key] = over.keys[key]
        return _mapping(over, children, {key: keys[key] for key in children})

    def rivals(self, key: str, path: tuple[str, ...], children: dict[str, Node]) -> list[str]:
        """Return the keys that ``key`` replaces; empty for named mappings."""
        rivals = sorted(_RIVALS.get(key, set()) & children.keys())
        if rivals:
            from simfoundry.spec.models.types import is_mapping, models_at

            models = [m for m in models_at(model_of(self.kind), path) if key in m.model_fields]
            return rivals if any(not is_mapping(m, key) for m in models) else []
        return rivals

    def nothing_to_remove(self, place: tuple[int, int], path: tuple[str, ...], there: Iterable[str]) -> None:
        message = f"the extended document has no `{path[-1]}`, so it cannot be removed"
        similar = nearest(path[-1], there)
        hint = similar if similar.startswith("did you mean") else "remove the line"
        self.findings.append(Diagnostic("SF201", Severity.ERROR, message, self.file, *place, ".".join(path), hint))


def _mapping(like: Node, children: dict[str, Node], keys: dict[str, tuple[int, int]]) -> Node:
    value = {key: child.value for key, child in children.items()}
    weight = 1 + sum(child.weight for child in children.values())
    return Node(value, like.line, like.column, children, keys, "", weight, like.file)


def _take_over(node: Node, kind: str, from_file: str, to_file: str) -> None:
    """Make the file references of a base relative to the folder of the document that extends it."""
    here, there = Path(from_file).parent.resolve(), Path(to_file).parent.resolve()
    if here == there:
        return
    from simfoundry.spec.models.types import file_patterns

    step = PurePosixPath(Path(os.path.relpath(here, there)).as_posix())
    for pattern in file_patterns(model_of(kind)):
        if pattern != ("extends",):
            for leaf in _leaves(node, pattern):
                if isinstance(leaf.value, str) and ":" not in leaf.value and not leaf.value.startswith("/"):
                    leaf.value = os.path.normpath(step / leaf.value)
    _refresh(node)


def _leaves(node: Node, pattern: tuple[str, ...]) -> Iterator[Node]:
    if not pattern:
        yield node
        return
    children = node.children
    if pattern[0] == "*":
        for child in children.values() if isinstance(children, dict) else children or ():
            yield from _leaves(child, pattern[1:])
    elif isinstance(children, dict) and pattern[0] in children:
        yield from _leaves(children[pattern[0]], pattern[1:])


def _refresh(node: Node) -> None:
    """Recompute the values of collections from their members."""
    if isinstance(node.children, dict):
        for child in node.children.values():
            _refresh(child)
        node.value = {key: child.value for key, child in node.children.items()}
    elif isinstance(node.children, list):
        for child in node.children:
            _refresh(child)
        node.value = tuple(child.value for child in node.children)
