"""Members of an included scene: their new names, and their poses in the frame of the include."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from simfoundry.spec.compose.copies import scalar_at, with_references
from simfoundry.spec.compose.join import LISTS, SECTIONS, members
from simfoundry.spec.models.reuse import IncludeSpec
from simfoundry.spec.yaml.nodes import Node


@dataclass(frozen=True)
class IncludedScene:
    """The members, lists and silenced warnings that an included scene adds to the scene that includes it.

    Attributes:
        name: The name of the include.
        at: The node of the include.
        sections: The members by section, with their new names.
        lists: The items of ``relations`` and ``no_contact``.
        allow: The silenced warnings, each for members of this include only, or None.
        faults: Messages and hints for content that cannot be included.
    """

    name: str
    at: Node
    sections: Mapping[str, Node]
    lists: Mapping[str, list[Node]]
    allow: Node | None
    faults: tuple[tuple[str, str], ...]


def included_scene(prefix: str, at: Node, include: IncludeSpec, root: Node) -> IncludedScene:
    """Return the content of a composed scene with its names prefixed and its poses relative to the include's frame."""
    keys = members(root)
    spaces = {section: {name: f"{prefix}_{name}" for name in members(keys.get(section))} for section in SECTIONS}
    viewpoint = keys.get("viewpoint")
    view = with_references(viewpoint, spaces, "viewpoint") if viewpoint is not None else None
    sections: dict[str, Node] = {}
    for section in SECTIONS:
        children, places = dict[str, Node](), dict[str, tuple[int, int]]()
        own = keys.get(section, at)
        for name, node in members(keys.get(section)).items():
            new = with_references(node, spaces)
            if include.pose is not None:
                new = _in_frame(section, new, prefix)
            if section == "objects":
                new = _seen_from(new, view, prefix if include.pose is not None else None)
            children[f"{prefix}_{name}"] = new
            places[f"{prefix}_{name}"] = own.keys[name]
        if children:
            sections[section] = own.with_members(children, places)
    if include.pose is not None:
        named = sections.get("frames", at.with_members({}))
        pose = members(at)["pose"]
        sections["frames"] = named.with_members({prefix: pose, **members(named)}, {**named.keys, prefix: pose.place})
    lists = {
        key: [with_references(item, spaces, key) for item in keys[key].members]
        for key in LISTS
        if key in keys and isinstance(keys[key].children, list)
    }
    allow = keys.get("allow")
    new_names = {name: new for names in spaces.values() for name, new in names.items()}
    scoped = _scoped(allow, new_names) if allow is not None else None
    return IncludedScene(prefix, at, sections, lists, scoped, tuple(_faults(keys)))


def _faults(keys: Mapping[str, Node]) -> Iterator[tuple[str, str]]:
    if members(keys.get("conflicts")):
        yield "the included scene has unresolved merge conflicts", "resolve them in its file"


def _in_frame(section: str, node: Node, frame: str) -> Node:
    """Return a member whose pose in the world becomes a pose in a frame."""
    if not isinstance(node.children, dict) or section == "materials":
        return node
    if section == "lights":
        return _with_frame(node, frame)
    if section == "frames":
        return node if "on" in node.children else _with_frame(node, frame)
    if section == "cameras" and "mount" in node.children:
        return node
    key = "place" if "place" in node.children else "pose"
    inner = node.children.get(key)
    if inner is None:
        inner = node.with_members({})
    return node.with_members({**node.children, key: _with_frame(inner, frame)}, {key: inner.place} | node.keys)


def _with_frame(node: Node, frame: str) -> Node:
    """Return a pose or place in a frame, unless it is already relative to another one."""
    if not isinstance(node.children, dict) or "frame" in node.children:
        return node
    return node.with_members({**node.children, "frame": scalar_at(frame, node)})


def _seen_from(node: Node, view: Node | None, frame: str | None) -> Node:
    """Return an object whose place keeps the viewpoint of the included scene."""
    place = members(node).get("place")
    sides = {"left_of", "right_of", "in_front_of", "behind"}
    seen = view.value if view is not None else frame
    if place is None or seen is None or not sides & members(place).keys() or "seen_from" in members(place):
        return node
    new = place.with_members({**members(place), "seen_from": scalar_at(seen, place)})
    return node.with_members({**members(node), "place": new})


def _scoped(allow: Node, names: Mapping[str, str]) -> Node | None:
    """Return the silenced warnings of an included scene, restricted to its members."""
    if not isinstance(allow.children, dict):
        return None
    codes = {}
    for code, node in allow.children.items():
        if isinstance(node.children, dict):
            given = {names.get(name, name): reason for name, reason in node.children.items()}
            codes[code] = node.with_members(given)
        elif isinstance(node.value, str):
            codes[code] = node.with_members(dict.fromkeys(names.values(), node))
    return allow.with_members(codes)
