"""Symbols, the meanings of names, and the members that define and change them."""

from __future__ import annotations

from dataclasses import dataclass

from simfoundry.spec.names.mentions import Path_

# What the members of each section are called.
KINDS = {
    "objects": "object",
    "robots": "robot",
    "links": "link",
    "joints": "joint",
    "axes": "joint",  # positions and predicates refer to an axis as to a joint
    "sites": "site",
    "actuators": "actuator",
    "sensors": "sensor",
    "subtasks": "subtask",
    "cameras": "camera",
    "lights": "light",
    "materials": "material",
    "frames": "frame",
    "templates": "template",
    "include": "include",
    "parameters": "parameter",
    "parts": "part",
    "variants": "variant",
}

# Sections whose members have names of their own.
HEADS = ("objects", "templates", "links", "joints", "include")


@dataclass(frozen=True, slots=True)
class Symbol:
    """Something with a name.

    Attributes:
        kind: What it is, such as ``object`` or ``joint``.
        name: Its name, where it is defined.
        file: The resolved path of the document that defines it; those that extend this document change it.
        section: Path of the mapping in which it is defined, such as ``("links", "door", "parts")``.
    """

    kind: str
    name: str
    file: str
    section: Path_

    def __str__(self) -> str:
        return f"{self.kind} `{self.name}`"


# A member in a document: the resolved path of the document, and the path of the member.
Layer = tuple[str, Path_]


@dataclass(frozen=True, slots=True)
class Meaning:
    """The meaning of a name.

    Attributes:
        symbol: What is named.
        segments: The parts of the name that name something, with their start and end: includes, then the symbol.
        layers: The members that define and change it, the most derived first.
    """

    symbol: Symbol
    segments: tuple[tuple[Symbol | None, int, int], ...]
    layers: tuple[Layer, ...]


def plain_meaning(symbol: Symbol, name: str, layers: tuple[Layer, ...]) -> Meaning:
    """Return the meaning of a name without a prefix."""
    return Meaning(symbol, ((symbol, 0, len(name)),), layers)
