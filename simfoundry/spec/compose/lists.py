"""Relations and pairs of a scene in which a repeated object stands for its copies."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product

from simfoundry.spec.change.diff.changes import names_in, renamed_reference
from simfoundry.spec.compose.copies import Group, scalar_at
from simfoundry.spec.compose.join import LISTS, members
from simfoundry.spec.yaml.nodes import Node


def with_copied_lists(root: Node, groups: Mapping[str, Group]) -> Node:
    """Return a document whose relations and pairs of repeated objects are replaced by those of their copies."""
    if not groups:
        return root
    keys = members(root)
    new = dict(keys)
    for key in LISTS:
        node = keys.get(key)
        if node is not None and isinstance(node.children, list):
            new[key] = node.with_members([copy for item in node.children for copy in _of_copies(key, item, groups)])
    return root.with_members(new)


def _of_copies(key: str, item: Node, groups: Mapping[str, Group]) -> list[Node]:
    """Return one item for each combination of copies that the names in a relation or pair stand for."""
    texts = [item] if isinstance(item.value, str) else item.children if isinstance(item.children, list) else []
    named = [name for node in texts if isinstance(node.value, str) for name in names_in(key, node.value)]
    roots = list(dict.fromkeys(groups[name].root for name in named if name in groups))
    if not roots:
        return [item]
    paired = len(named) == 2 and named[0] == named[1]  # all pairs of copies of one object
    ranges = [groups[root].copies for root in roots]
    out = []
    for chosen in product(*ranges, *(ranges if paired else [])):
        index = dict(zip(roots, (copy.index for copy in chosen), strict=False))
        new = {name: groups[name].named(index[groups[name].root]) for name in named if name in groups}
        if None in new.values() or (paired and chosen[0].index >= chosen[1].index):
            continue
        spaces = {"objects": {name: copy for name, copy in new.items() if copy is not None}}
        values = [renamed_reference(key, node.value, spaces) for node in texts]
        if paired and len(texts) == 2:
            values[1] = chosen[1].name
        nodes = [scalar_at(value, node) for value, node in zip(values, texts, strict=True)]
        out.append(nodes[0] if not isinstance(item.children, list) else item.with_members(nodes))
    return out
