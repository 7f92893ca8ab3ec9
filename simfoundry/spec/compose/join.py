"""Join the nodes of documents, and adapt file references to another folder."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Protocol

from simfoundry.spec.diagnostics import Diagnostic, Fix, Severity, similar_fixes
from simfoundry.spec.models.kinds import model_of
from simfoundry.spec.yaml.nodes import Node
from simfoundry.spec.yaml.text import Path_

# Sections whose members may be copies or come from an included scene.
SECTIONS = ("materials", "frames", "objects", "robots", "cameras", "lights")

# Lists whose items refer to members of a scene. Those of an included scene are added to those of the including scene.
LISTS = ("relations", "no_contact")

# The kind of document that can reuse parts.
SCENE = "scene/1"


class Fault(Protocol):
    """A function that adds an error at a node."""

    def __call__(
        self,
        code: str,
        node: Node,
        path: tuple[str | int, ...],
        message: str,
        hint: str = "",
        fixes: tuple[Fix, ...] = (),
    ) -> None:
        """Add an error. ``fixes`` can be written instead of the node's text."""


# A section and a name in it.
Member = tuple[str, str]


def members(node: Node | None) -> dict[str, Node]:
    """Return the values of a mapping, or an empty mapping for any other node."""
    return node.children if node is not None and isinstance(node.children, dict) else {}


def mark_file(node: Node, file: str) -> None:
    """Mark every value that has no source file yet with its source file."""
    todo = [node]
    while todo:
        node = todo.pop()
        node.file = node.file or file
        todo += node.members


@dataclass
class Joining:
    """The state needed while joining a document with its base.

    Attributes:
        kind: The kind of the documents.
        file: Path of the document that is joined with the base.
        keeps_removals: If set, an entry that removes a value is kept, because the value may come from a template, a
            repeated object or an included scene. Such entries are listed in ``removals``.
        removals: Paths of entries that remove values which are written out later, each with the finding for the case
            that there is no such value, or None if a base contains the value.
        findings: Findings for entries that remove values which do not exist.
        added: Members that the document adds to its base, as a mapping from their paths to the names in the base.
    """

    kind: str
    file: str
    keeps_removals: bool = False
    removals: dict[Path_, Diagnostic | None] = field(default_factory=dict)
    findings: list[Diagnostic] = field(default_factory=list)
    added: dict[Path_, tuple[str, ...]] = field(default_factory=dict)

    def join(self, base: Node, over: Node, path: tuple[str, ...]) -> Node:
        """Return ``base`` overridden by ``over``: mappings are merged by key, and null removes a key."""
        if not isinstance(base.children, dict) or not isinstance(over.children, dict):
            return over
        children, keys = dict(base.children), dict(base.keys)
        for key, node in over.children.items():
            if node.value is None:
                self.remove(children, key, node, over.keys[key], path)
                keys[key] = over.keys[key]
                continue
            for rival in self.rivals(key, path, children):
                if rival not in over.children:
                    del children[rival]
            if key not in base.children:
                self.added[*path, key] = tuple(base.children)
            children[key] = self.join(children[key], node, (*path, key)) if key in children else node
            keys[key] = over.keys[key]
        return over.with_members(children, keys)

    def remove(
        self, children: dict[str, Node], key: str, null: Node, place: tuple[int, int], path: tuple[str, ...]
    ) -> None:
        """Remove a key from ``children``, or keep its removal for the value that is written out later."""
        here, known = (*path, key), key in children
        finding = None if known else self.nothing_to_remove(place, here, null.file or self.file, children)
        if self.keeps_removals and path and path[0] in (*SECTIONS, "templates"):
            children[key] = null
            self.removals.setdefault(here, finding)
            return
        children.pop(key, None)
        finding = self.removals.get(here, finding)
        if not known and finding is not None:
            self.findings.append(finding)

    def rivals(self, key: str, path: tuple[str, ...], children: dict[str, Node]) -> list[str]:
        """Return the keys that ``key`` replaces. The result is empty for named mappings."""
        from simfoundry.spec.models.types import RIVALS, is_mapping, models_at

        rivals = sorted(RIVALS.get(key, set()) & children.keys())
        models = [m for m in models_at(model_of(self.kind), path) if key in m.model_fields] if rivals else []
        return rivals if any(not is_mapping(m, key) for m in models) else []

    def nothing_to_remove(
        self, place: tuple[int, int], path: tuple[str, ...], file: str, there: Iterable[str]
    ) -> Diagnostic:
        """Return the finding for an entry that removes a value which does not exist."""
        message = f"`{path[-1]}` cannot be removed: neither a base nor anything reused here contains it"
        fixes = similar_fixes(path[-1], there)
        hint = f"did you mean `{fixes[0].text}`?" if fixes else "remove the line"
        return Diagnostic("SF201", Severity.ERROR, message, file, *place, ".".join(path), hint, fixes=fixes)


def relocate(node: Node, kind: str, from_file: str, to_file: str) -> None:
    """Rewrite the file references in a base to be relative to the folder of the document that extends the base."""
    here, there = Path(from_file).parent.resolve(), Path(to_file).parent.resolve()
    if here == there:
        return
    from simfoundry.spec.models.types import file_patterns

    step = PurePosixPath(Path(os.path.relpath(here, there)).as_posix())
    # A node can occur several times: once for each alias, and once for each copy of a repeated object.
    patterns = (pattern for pattern in file_patterns(model_of(kind)) if pattern != ("extends",))
    for leaf in {id(leaf): leaf for pattern in patterns for leaf in _leaves(node, pattern)}.values():
        if isinstance(leaf.value, str) and ":" not in leaf.value and not leaf.value.startswith("/"):
            leaf.value = os.path.normpath(step / leaf.value)
    _refresh(node)


def _leaves(node: Node, pattern: tuple[str, ...]) -> Iterator[Node]:
    if not pattern:
        yield node
        return
    children = node.children
    named = [children[pattern[0]]] if isinstance(children, dict) and pattern[0] in children else []
    for child in node.members if pattern[0] == "*" else named:
        yield from _leaves(child, pattern[1:])


def _refresh(node: Node) -> None:
    """Recompute the values of collections from their members."""
    for child in node.members:
        _refresh(child)
    if isinstance(node.children, dict):
        node.value = {key: child.value for key, child in node.children.items()}
    elif isinstance(node.children, list):
        node.value = tuple(child.value for child in node.children)
