"""The names that a document can use, each with a short description."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from simfoundry.errors import SimfoundryError
from simfoundry.language_server.cursor.blocks import Block, keys_of
from simfoundry.spec.check.names import asset_in
from simfoundry.spec.files import FileError, Loaded
from simfoundry.spec.models.asset import AssetSpec
from simfoundry.spec.models.base import quantity_value
from simfoundry.spec.models.joint import JointSpec
from simfoundry.spec.models.robot_file import find_robot
from simfoundry.spec.yaml.spelling import number

# Names that can be valid; others could not be inserted as they are.
_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*\Z")

# Key that names the document in which a document looks up names, by the kind of the document.
_SCENE = {"task": "scene", "cousins": "twin", "capture": "truth"}


@dataclass(frozen=True)
class KnownName:
    """A name with the section that defines it, such as ``objects``.

    ``note`` is a short description, by default that of the data of the ``member``.
    """

    name: str
    section: str
    note: str = ""
    member: Any = None

    def describe(self) -> str:
        """Return a short description."""
        return self.note or _described(self.section, self.member)


class KnownNames:
    """The names that a document can use.

    Args:
        loaded: The latest text of the document that could be parsed, or None.
        kind: The kind of the document, such as ``scene``.
        text: The current text, which may contain names that are not known yet.
    """

    def __init__(self, loaded: Loaded | None, kind: str, text: str) -> None:
        self.loaded, self.kind, self._text = loaded, kind, text
        self._sections: dict[str, dict[str, Any]] = {}

    @cached_property
    def home(self) -> Loaded | None:
        """Return the scene or asset that defines the names: that of a task, of a recipe's twin, or the document."""
        loaded = self.loaded
        for _ in range(2):  # the scene of the task that is a recipe's twin
            data = loaded.document.data if loaded is not None and loaded.document is not None else None
            kind = str(data.get("simfoundry")).partition("/")[0] if isinstance(data, dict) else ""
            reference = data.get(_SCENE[kind]) if isinstance(data, dict) and kind in _SCENE else None
            if loaded is None or not isinstance(reference, str):
                break
            loaded = _used(loaded, reference)
        return loaded

    def section(self, name: str) -> dict[str, Any]:
        """Return the members of a section, by name."""
        if name not in self._sections:
            home = self.home
            data = home.document.section(name) if home is not None and home.document is not None else {}
            found = {key: value for key, value in data.items() if value is not None and _NAME.match(key)}
            if home is self.loaded and (home is None or home.source is None or home.source.text != self._text):
                found = {**found, **dict.fromkeys(key for key in self._new(name) if key not in found)}
            self._sections[name] = found
        return self._sections[name]

    def _new(self, section: str) -> Iterator[str]:
        """Yield the names that the current text defines in a section."""
        text = f"\n{self._text}".replace("\r\n", " \n")
        head = re.search(rf"\n{section}:[ \t]*(?:#[^\n]*)?\n(?:[ \t]*(?:#[^\n]*)?\n)*(?P<indent> +)(?=[^\s#-])", text)
        if head is None:
            return
        block = Block((section,), None, "map", len(head["indent"]), head.end())
        repeated = self.loaded.reuse.groups if self.loaded is not None and self.loaded.reuse is not None else {}
        for name, _ in keys_of(text, block, head.end()):
            if name not in repeated:
                yield name

    def names(self, *sections: str, apart: Collection[str] = ()) -> Iterator[KnownName]:
        """Yield the names in sections, except for those in ``apart``."""
        for section in sections:
            for name in self.repeated if section == "objects" else ():
                if name not in apart:
                    yield KnownName(name, section, "repeated object")
            for name, member in self.section(section).items():
                if name not in apart:
                    yield KnownName(name, section, member=member)
            if section == "joints":  # the axes of joints with several axes
                for joint in self.section("joints").values():
                    axes = joint.get("axes") if isinstance(joint, dict) else None
                    for name, axis in (axes if isinstance(axes, dict) else {}).items():
                        yield KnownName(name, section, member=axis)

    def is_fixed(self, name: str) -> bool:
        """Return True if an object is fixed to the world."""
        member = self.section("objects").get(name)
        return isinstance(member, dict) and member.get("fixed") is True

    @cached_property
    def repeated(self) -> list[str]:
        """Return the names of repeated objects, which stand for the copy that belongs to another copy."""
        home = self.home
        reuse = home.reuse if home is not None and home is self.loaded else None
        return [name for name, group in reuse.groups.items() if group.copies] if reuse is not None else []

    # -- parts of members -------------------------------------------------------------------------------------------

    def asset(self, owner: str) -> AssetSpec | None:
        """Return the asset of an object."""
        member = self.section("objects").get(owner)
        reference = member.get("asset") if isinstance(member, dict) else None
        home = self.home
        return asset_in(_used(home, reference)) if home is not None and isinstance(reference, str) else None

    def parts(self, owner: str, *sections: str) -> Iterator[KnownName]:
        """Yield the names that belong to an object or a robot: ``links``, ``joints``, or the ``parts`` of its links."""
        asset = self.asset(owner)
        robot = self.section("robots").get(owner)
        if asset is None:
            for of_robot in self.robot(robot)[0] if "links" in sections else ():
                yield KnownName(of_robot, "links", "link")
            return
        joints = asset.single_joints
        if "links" in sections:
            for name, link in asset.links.items():
                mass = quantity_value(link.mass)
                yield KnownName(name, "links", "link" + (f", {number(mass)} kg" if mass is not None else ""))
        if "joints" in sections:
            for name, joint in joints.items():
                if "links" not in sections or name not in asset.links:
                    yield KnownName(name, "joints", joint_detail(joint))
        if "parts" in sections:
            for link_name, link in asset.links.items():
                yield from (KnownName(part, "parts", f"part of {link_name}") for part in link.parts)

    def moving_joints(self, owner: str) -> Iterator[KnownName]:
        """Yield the joints of an object that are not fixed."""
        asset = self.asset(owner)
        for name, joint in asset.single_joints.items() if asset is not None else ():
            if joint.type != "fixed":
                yield KnownName(name, "joints", joint_detail(joint))

    def robot(self, member: Any) -> tuple[tuple[str, ...], Mapping[str, float]]:
        """Return the links and the home joint positions of a robot."""
        model = member.get("model") if isinstance(member, dict) else None
        try:
            known = find_robot(model) if isinstance(model, str) else None
        except SimfoundryError:
            known = None
        return (known.links, known.home) if known is not None else ((), {})


def _used(loaded: Loaded, reference: str) -> Loaded | None:
    try:
        return loaded.used(reference)
    except (FileError, OSError, RuntimeError, ValueError):
        return None


def joint_detail(joint: JointSpec) -> str:
    """Describe a joint: its type and its range."""
    limits, unit = (joint.limits_deg, "°") if joint.limits_deg is not None else (joint.limits, " m")
    bounds = f", {number(limits[0])} to {number(limits[1])}{unit}" if limits is not None else ""
    return f"{joint.type} joint{bounds}"


def _described(section: str, member: Any) -> str:
    """Describe a member of a section, whose data may be invalid."""
    if section == "parameters":
        return f"= {member}"[:60]
    if not isinstance(member, dict):
        return _ONE.get(section, "")
    words = [_geometry(member) if section in ("objects", "templates") else _ONE.get(section, "")]
    match section:
        case "objects" | "templates":
            mass = member.get("mass")
            mass = mass.get("value") if isinstance(mass, dict) else mass
            words += [f"{mass} kg"] * isinstance(mass, int | float)
            words += ["fixed"] * (member.get("fixed") is True)
        case "materials":
            words += [f"{member.get('density')} kg/m³"] * ("density" in member)
            words += [f"friction {member.get('friction')}"] * ("friction" in member)
        case "robots":
            words += [str(member.get("model"))] * isinstance(member.get("model"), str)
        case "cameras":
            words += [_sizes(member.get("size"), " px")]
            words += [f"on {member.get('mount')}"] * ("mount" in member)
        case "frames":
            words += [f"on {member[key]}" for key in ("on", "frame") if key in member]
        case "joints":
            words += [str(member.get("type", "several axes"))]
        case "sites":
            words += [f"on {member.get('link')}"]
    return ", ".join(word[:60] for word in words if word)


# What a member of a section is.
_ONE = {
    "objects": "object",
    "materials": "material",
    "robots": "robot",
    "cameras": "camera",
    "frames": "frame",
    "joints": "joint",
    "links": "link",
    "sites": "site",
    "lights": "light",
    "templates": "template",
    "include": "included scene",
    "parts": "part",
    "subtasks": "step",
}


def _geometry(member: dict[str, Any]) -> str:
    """Describe the shape or mesh of an object."""
    shape = member.get("shape")
    if isinstance(shape, dict) and len(shape) == 1:
        ((kind, size),) = shape.items()
        if isinstance(size, dict):
            size = tuple(value for value in size.values() if isinstance(value, int | float))
        return f"{str(kind).replace('_', ' ')} {_sizes(size, ' m')}".strip()
    asset = member.get("asset")
    return str(asset).rpartition("/")[2] if isinstance(asset, str) else "object"


def _sizes(values: Any, unit: str) -> str:
    listed = values if isinstance(values, tuple) else (values,)
    plain = [number(value) for value in listed if isinstance(value, int | float) and abs(value) < 1e9]
    return f"{' × '.join(plain)}{unit}" if plain and len(plain) <= 3 else ""
