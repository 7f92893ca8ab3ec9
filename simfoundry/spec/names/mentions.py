"""Every place of one document that names something, by the rules of ``keys.yaml``."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache
from typing import Any

from simfoundry.errors import SimfoundryError
from simfoundry.spec.change.diff.changes import BESIDE, NAMED
from simfoundry.spec.change.merge.conflict import parts
from simfoundry.spec.check.varied_choices import COLORS
from simfoundry.spec.check.varied_fields import SCENE_KEYS, SECTIONS
from simfoundry.spec.compose.parameters import PARAMETER, holds_text, is_expression
from simfoundry.spec.models.kinds import KINDS
from simfoundry.spec.models.native import mjcf_names
from simfoundry.spec.models.predicate import PREDICATES, canonical
from simfoundry.spec.models.scene import DEFAULT_VARIANT
from simfoundry.spec.models.types import EXPRESSIONS, NAMES, REFERENCES
from simfoundry.spec.names.positions import SourceMap, TextIndex
from simfoundry.spec.yaml.nodes import Node
from simfoundry.spec.yaml.text import Document

Path_ = tuple[str | int, ...]

# The sections in which a name is looked up, first match first.
Sections = tuple[str, ...]

# Sections of what an object consists of, for names such as ``cabinet.drawer``. A link comes before the joint that moves
# it, as where predicates and poses are evaluated.
TAIL: Sections = ("links", "joints", "parts")

# Sections that a warning, and thus `allow`, can be about.
WARNED: Sections = (*NAMED, "parameters")

# The head and the tail of a name such as ``cabinet.drawer``.
_DOTTED = re.compile(r"([A-Za-z_][A-Za-z0-9_]*)(?:\.([A-Za-z_][A-Za-z0-9_]*))?\Z")

# Sections of a scene, by the word with which the path of a varied value starts.
VARIED_SECTIONS = {**SECTIONS, "parameter": "parameters"}

# Predicate with the argument list that is open at its name, also while it is being typed.
_CALL = re.compile(r"\s*([A-Za-z]\w*)\s*\(")
_ARGUMENT = re.compile(r"([(,])\s*+(?:([a-z][a-z0-9_]*)(?:\.([a-z][a-z0-9_]*))?)?(?=\s*(?:[,)]|\Z))")

# Sections in which each kind of argument of a predicate is looked up, and those of its tail.
_KINDS: dict[str, tuple[Sections, Sections]] = {
    "thing": (("objects",), TAIL),
    "body": (("objects", "robots"), TAIL),
    "joint": (("objects",), ("joints", "links")),
    "robot": (("robots",), ()),
    "number": ((), ()),
}

# Sections of the elements that native attributes refer to, after the name of the object.
_NATIVE: dict[str, Sections] = {
    "joint": ("joints",),
    "body": ("links",),
    "site": ("sites",),
    "geom": ("links", "parts"),
    "actuator": ("actuators",),
    "sensor": ("sensors",),
    "equality": ("joints",),
}


@dataclass(frozen=True, slots=True)
class Owner:
    """The member whose own names are meant, such as the object of a joint: its name, and where that is looked up."""

    sections: Sections
    name: str


@dataclass(frozen=True, slots=True)
class Mention:
    """A name in a text.

    Attributes:
        name: The name.
        start: Offset of its first character.
        end: Offset after its last character.
        path: Path of the value that contains it or, for a key, of the value of the key.
        sections: Where the name is looked up.
        owner: The member whose own names are looked up, or None for names of the document.
        is_key: True if the name is a key.
        is_optional: True if the name may be one that the project does not define, as in data for a single format.
    """

    name: str
    start: int
    end: int
    path: Path_
    sections: Sections
    owner: Owner | None = None
    is_key: bool = False
    is_optional: bool = False


@dataclass(frozen=True)
class DocumentNames:
    """The names in one document.

    Attributes:
        file: The resolved path of the document.
        kind: The kind of the document, such as ``scene``, or an empty string if it is unknown.
        data: The content of the document.
        mentions: Every place that names something, in the order of the text.
        index: The text.
    """

    file: str
    kind: str
    data: dict[str, Any]
    mentions: tuple[Mention, ...]
    index: TextIndex = field(repr=False)

    def member(self, path: Path_) -> Any:
        """Return the value at a path, or None if there is none."""
        value: Any = self.data
        for part in path:
            value = value.get(part) if isinstance(value, dict) else None
        return value

    def section(self, *path: str) -> dict[str, Any]:
        """Return the mapping at a path, which is empty if there is none."""
        found = self.member(path)
        return found if isinstance(found, dict) else {}


def document_names(document: Document, file: str) -> DocumentNames:
    """Return the names in a document as it was parsed, before it was joined with others.

    The document may have errors of any other kind than those of YAML.
    """
    data = document.data if isinstance(document.data, dict) else {}
    kind = str(data["simfoundry"]).partition("/")[0] if data.get("simfoundry") in KINDS else ""
    index = TextIndex(document.text)
    walk = _Walk(index, kind)
    if kind and isinstance(document.root.children, dict):
        for key, child in document.root.children.items():
            walk.entry(key, child)
    unique = {(m.start, m.end, m.sections, m.owner): m for m in walk.found}  # aliases repeat what their anchor names
    return DocumentNames(file, kind, data, tuple(sorted(unique.values(), key=lambda m: m.start)), index)


@dataclass
class _Step:
    """A path in the table of mappings whose keys are names.

    Attributes:
        section: The section of the names, or an empty string if the keys of the mapping are not names.
        is_owned: True if the names belong to a member, such as the joints of an object.
        below: The next steps.
    """

    section: str = ""
    is_owned: bool = False
    below: dict[str, _Step] = field(default_factory=dict)

    def into(self, key: str) -> _Step:
        """Return the step for a key of the mapping."""
        return self.below.get("@") or self.below.get(key) or self.below.get("*") or _EMPTY

    def owner(self, key: str) -> Owner | None:
        """Return the member that the values below a key belong to, or None if they belong to the same as before."""
        return Owner((self.section,), key) if "@" in self.below else None


_EMPTY = _Step()


@cache
def _tries() -> dict[str, _Step]:
    """Return the table of mappings whose keys are names as a tree, by the kind of the document."""
    roots: dict[str, _Step] = {}
    for kind, patterns in NAMES.items():
        for pattern, section in patterns.items():
            step = roots.setdefault(kind, _Step())
            for part in pattern.split("."):
                step = step.below.setdefault(part, _Step())
            of, dot, own = section.partition(".")
            step.section, step.is_owned = own or of, bool(dot)
    return roots


@dataclass
class _Walk:
    """The walk over one document."""

    index: TextIndex
    kind: str
    found: list[Mention] = field(default_factory=list)

    def entry(self, key: str, node: Node) -> None:
        """Add the names in one key of the document."""
        if key == "allow":
            self._allow(node)
        elif key == "conflicts":
            self._conflicts(node)
        elif key == "native":
            self._native(node)
        elif key == "vary" and self.kind == "cousins":
            self._vary(node)
        elif key not in ("name", "description", "origin", "simfoundry", "extends"):
            self._value(node, (key,), key, _tries().get(self.kind, _EMPTY).into(key), None)

    def _value(self, node: Node, path: Path_, key: str, step: _Step, owner: Owner | None) -> None:
        """Add the names in a value.

        Args:
            node: The value.
            path: Its path.
            key: The field that contains it, or an empty string if its key is a name.
            step: The step of the table for its path.
            owner: The member that it belongs to.
        """
        if isinstance(node.children, dict):
            for name, child in node.children.items():
                here = (*path, name)
                if step.section:
                    member = owner if step.is_owned else None
                    self._add(self.index.ranges(name, *node.keys[name]), 0, name, here, (step.section,), member, True)
                elif name == "native":
                    continue  # the native attributes of single elements name nothing
                field_name = "" if step.section else name
                self._value(child, here, field_name, step.into(name), step.owner(name) or owner)
        elif isinstance(node.children, list):
            for k, item in enumerate(node.children):
                self._value(item, (*path, k), key, _EMPTY, owner)
        elif isinstance(node.value, str):
            self._scalar(node, path, key, owner)

    def _scalar(self, node: Node, path: Path_, key: str, owner: Owner | None) -> None:
        text: str = node.value
        if self.kind == "scene" and "$" in text and is_expression(text) and not holds_text(path):
            at = self.index.of(node)
            for name in PARAMETER.finditer(text):
                self._add(at, name.start(1), name[1], path, ("parameters",))
        elif key in BESIDE:
            if text != DEFAULT_VARIANT and owner is not None:
                self._add(self.index.of(node), 0, text, path, (BESIDE[key],), owner)
        elif key in EXPRESSIONS:
            self._expression(node, path)
        elif key in REFERENCES and (dotted := _DOTTED.match(text)) is not None:
            self._dotted(self.index.of(node), dotted, 1, path, REFERENCES[key], TAIL)

    def _dotted(
        self, at: SourceMap, found: re.Match[str], group: int, path: Path_, sections: Sections, tail: Sections
    ) -> None:
        """Add the name in one group of a match, and the name of its part in the next group."""
        head, part = found[group], found[group + 1]
        self._add(at, found.start(group), head, path, sections)
        if part and tail:
            self._add(at, found.start(group + 1), part, path, tail, Owner(sections, head))

    def _expression(self, node: Node, path: Path_) -> None:
        text: str = node.value
        call = _CALL.match(text)
        if call is None:
            return
        at, arguments = self.index.of(node), list(_ARGUMENT.finditer(text, call.end() - 1))
        for found, kind in zip(arguments, _argument_kinds(call[1], len(arguments)), strict=True):
            sections, tail = _KINDS.get(kind, _KINDS["body"])
            if found[2] and sections:
                self._dotted(at, found, 2, path, sections, tail)

    def _allow(self, node: Node) -> None:
        for code, entry in _members(node):
            for name, _ in _members(entry):
                self._path_key(entry, name, ("allow", code, name), [*_split(name)])

    def _conflicts(self, node: Node) -> None:
        """Add the names in the paths of conflicts and in the values of both sides."""
        for key, entry in _members(node):
            self._path_key(node, key, ("conflicts", key), [*_split(key)])
            step, owner, is_name = _tries().get(self.kind, _EMPTY), None, False
            path = parts(key)
            for part in path:
                owner, is_name, step = step.owner(part) or owner, bool(step.section), step.into(part)
            for side, value in _members(entry):
                name = "" if is_name or not path else path[-1]
                self._value(value, ("conflicts", key, side), name, step, owner)

    def _path_key(self, node: Node, key: str, path: Path_, steps: list[tuple[int, str]]) -> None:
        """Add the names in a key that is a path, such as ``objects.cup.mass``, or a single name."""
        at = self.index.ranges(key, *node.keys[key])
        if len(steps) == 1:
            self._add(at, *steps[0], path, WARNED, None, True, True)
            return
        step, owner = _tries().get(self.kind, _EMPTY), None
        for start, name in steps:
            if step.section:
                self._add(at, start, name, path, (step.section,), owner if step.is_owned else None, True, True)
            owner, step = step.owner(name) or owner, step.into(name)

    def _vary(self, node: Node) -> None:
        """Add the names in the paths of values that a recipe varies, such as ``object.cup.mass`` or ``cabinet.drawer``,
        and in the values to choose from. Patterns with `*` are no names.
        """
        for key, entry in _members(node):
            at, path = self.index.ranges(key, *node.keys[key]), ("vary", key)
            (_, head), *rest = steps = [*_split(key)]
            if head in VARIED_SECTIONS:
                section = VARIED_SECTIONS[head]
                step, owner = _tries()["scene"].into(section), None
                for start, name in rest:
                    if name == "asset" and owner is not None:  # what follows are members of the object's asset
                        step = _tries()["asset"]
                        continue
                    if step.section:
                        self._add(at, start, name, path, (step.section,), owner, True, True)
                    owner, step = step.owner(name) or owner, step.into(name)
            elif rest and head not in SCENE_KEYS:
                joint = Owner(("objects",), head)
                self._add(at, *steps[0], path, ("objects",), None, True, True)
                self._add(at, *rest[0], path, ("joints",), joint, True, True)
            last = key.rpartition(".")[2]
            sections = ("materials",) if last in ("color", "material") else REFERENCES.get(last, ())
            choices = dict(_members(entry)).get("choose")
            for item in choices.children if sections and choices and isinstance(choices.children, list) else ():
                if isinstance(item.value, str) and (last != "color" or item.value not in COLORS):
                    self._add(self.index.of(item), 0, item.value, (*path, "choose"), sections, is_optional=True)

    def _native(self, node: Node) -> None:
        """Add the names of elements of objects in the native data of a scene, such as ``cabinet.drawer``."""
        tags = {key: tag for tag, keys in mjcf_names()["references"].items() for key in keys}
        for section, value in _members(dict(_members(node)).get("mjcf")):
            for name, listed in _members(value) if section == "order" else ():
                self._native_name(listed, ("native", "mjcf", section, name), name)
            todo: list[tuple[Node, Path_]] = [(value, ("native", "mjcf", section))]
            while todo:
                element, path = todo.pop()
                data = element.value if isinstance(element.value, dict) else {}
                of_type = {"objname": data.get("objtype"), "refname": data.get("reftype")}
                for key, child in _members(element):
                    tag = tags.get(key) or str(of_type.get(key) or "").removeprefix("x")
                    self._native_name(child, (*path, key), tag)
                    todo.append((child, (*path, key)))
                if isinstance(element.children, list):
                    todo += ((item, (*path, k)) for k, item in enumerate(element.children))

    def _native_name(self, node: Node, path: Path_, tag: str) -> None:
        for item in node.children if isinstance(node.children, list) else (node,):
            if not isinstance(item.value, str) or (tag not in _NATIVE and tag != "camera"):
                continue
            at, steps = self.index.of(item), [*_split(item.value)]
            head: Sections = ("cameras",) if tag == "camera" else ("objects",)
            for k, (start, name) in enumerate(steps[: 1 if tag == "camera" else 3]):
                sections = head if k == 0 else _NATIVE[tag] if k == 1 else ("parts",)
                owner = Owner(head, steps[0][1]) if k else None
                self._add(at, start, name, path, sections, owner, is_optional=True)

    def _add(
        self,
        at: SourceMap,
        start: int,
        name: str,
        path: Path_,
        sections: Sections,
        owner: Owner | None = None,
        is_key: bool = False,
        is_optional: bool = False,
    ) -> None:
        if name:
            place = at.range(start, start + len(name))
            self.found.append(Mention(name, *place, path, sections, owner, is_key, is_optional))


def _members(node: Node | None) -> Iterator[tuple[str, Node]]:
    yield from node.children.items() if node is not None and isinstance(node.children, dict) else ()


def _split(text: str) -> Iterator[tuple[int, str]]:
    """Yield the parts of a dotted path with their starts. Parts that are no names have an empty name."""
    for found in re.finditer(r'"(?:[^"\\]|\\.)*"|[^."]+', text):
        name = re.match(r"[a-z][a-z0-9_]*(?=\Z| #)", found[0])
        yield found.start(), name[0] if name is not None else ""


@cache
def _argument_kinds(predicate: str, count: int) -> tuple[str, ...]:
    """Return the kind of each argument of a predicate, in the order in which they are written."""
    order = tuple(map(str, range(count)))
    name, mapped = canonical(predicate, order)
    kinds: tuple[str, ...] = ()
    if name in PREDICATES:
        try:
            kinds = PREDICATES.load(name).parameters
        except SimfoundryError:  # a broken plug-in, which `check` reports
            kinds = ()
    by_place = dict(zip(mapped, kinds, strict=False))
    return tuple(by_place.get(place, "body") for place in order)
