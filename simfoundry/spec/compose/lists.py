"""Relations and pairs of a scene in which a repeated object stands for its copies."""

from __future__ import annotations

import math
from collections.abc import Mapping, Set
from itertools import product

from simfoundry.spec.change.diff.changes import names_in, renamed_reference
from simfoundry.spec.compose.copies import Group, scalar_at
from simfoundry.spec.compose.join import LISTS, Fault, members
from simfoundry.spec.yaml.nodes import Node

# Maximum number of relations or pairs that one item can stand for; a scene can have 1,000 pairs.
MAX_ITEMS = 10_000


def with_copied_lists(root: Node, groups: Mapping[str, Group], removed: Set[str], fault: Fault) -> Node:
    """Return a document whose relations and pairs of repeated objects are replaced by those of their copies.

    Items that mention a copy or an included member that was ``removed`` are dropped.
    """
    if not groups and not removed:
        return root
    keys = members(root)
    new = dict(keys)
    for key in LISTS:
        node = keys.get(key)
        if node is not None and isinstance(node.children, list):
            items = [copy for item in node.children for copy in _of_copies(key, item, groups, fault)]
            items = [item for item in items if not removed or not _names(key, item) & removed]
            new[key] = node.with_members(items)
    return root.with_members(new)


def _names(key: str, item: Node) -> set[str]:
    """Return the names in a relation or pair."""
    texts = item.children if isinstance(item.children, list) else [item]
    return {name for node in texts if isinstance(node.value, str) for name in names_in(key, node.value)}


def _of_copies(key: str, item: Node, groups: Mapping[str, Group], fault: Fault) -> list[Node]:
    """Return one item for each combination of copies that the names in a relation or pair stand for."""
    texts = [item] if isinstance(item.value, str) else item.children if isinstance(item.children, list) else []
    named = [name for node in texts if isinstance(node.value, str) for name in names_in(key, node.value)]
    roots = list(dict.fromkeys(groups[name].root for name in named if name in groups))
    if not roots:
        return [item]
    same = len(texts) == 2 and len(named) == 2 and named[0] == named[1]  # each pair of copies of one object
    choices = [groups[root].copies for root in roots] * (2 if same else 1)
    if math.prod(map(len, choices)) > MAX_ITEMS:
        message = f"with the copies of `{named[0]}`, this stands for more than {MAX_ITEMS} items"
        fault("SF005", item, (key,), message, "name fewer copies")
        return []
    out = []
    for chosen in product(*choices):
        index = dict(zip(roots, (copy.index for copy in chosen), strict=False))
        new = {name: groups[name].named(index[groups[name].root]) for name in named if name in groups}
        if None in new.values() or (same and chosen[0].index >= chosen[1].index):
            continue
        spaces = {"objects": {name: copy for name, copy in new.items() if copy is not None}}
        values = [renamed_reference(key, node.value, spaces) for node in texts]
        if same:
            values[1] = chosen[1].name
        nodes = [scalar_at(value, node) for value, node in zip(values, texts, strict=True)]
        out.append(nodes[0] if not isinstance(item.children, list) else item.with_members(nodes))
    return out
