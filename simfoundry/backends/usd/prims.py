"""Prims, attributes, relationships and transforms of a stage.

Prims are plain Python and become text at the end (:mod:`~simfoundry.backends.usd.usda`): authoring through USD's own
layers takes five times as long. A vector, a quaternion (w first) or a row of a matrix is a tuple, an array a list.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from simfoundry.backends.artifact import rounded
from simfoundry.geometry.frames import IDENTITY, Pose


class Attribute(NamedTuple):
    """A value of a prim, and the type that USD calls it; None where it has no value, or a ``source`` instead."""

    type_name: str
    value: Any
    uniform: bool = False
    source: str = ""


class Asset(NamedTuple):
    """A path of a file, as the value of an attribute."""

    path: str


class Targets(NamedTuple):
    """The targets of a relationship: paths of the stage."""

    paths: tuple[str, ...]

    @property
    def value(self) -> Targets:
        """Itself, where that of an attribute is asked for."""
        return self


@dataclass(eq=False, slots=True)
class Prim:
    """A prim as it grows.

    ``path`` is how the stage calls it, whichever variants it is drawn in; ``references`` are as USD writes them. A prim
    with ``variants`` has one set of them, called ``variant``, of which one is ``selected``; each is a prim of its own
    name and type.
    """

    name: str
    type_name: str
    path: str
    specifier: str = "def"
    kind: str = ""
    schemas: list[str] = field(default_factory=list)
    custom_data: dict[str, Any] = field(default_factory=dict)
    references: list[str] = field(default_factory=list)
    properties: dict[str, Attribute | Targets] = field(default_factory=dict)
    children: dict[str, Prim] = field(default_factory=dict)
    variants: dict[str, Prim] = field(default_factory=dict)
    selected: str = ""

    def variant(self, name: str) -> Prim:
        """Add the variant ``name``; what is drawn on it is there where it is selected."""
        self.variants[name] = Prim(self.name, self.type_name, self.path)
        return self.variants[name]


def define(parent: Prim, name: str, type_name: str, schemas: Sequence[str] = (), specifier: str = "def") -> Prim:
    """Define a child prim of a type, with the API schemas applied to it."""
    prim = Prim(name, type_name, f"{parent.path}/{name}", specifier, schemas=list(schemas))
    parent.children[name] = prim
    return prim


def apply_schemas(prim: Prim, schemas: Sequence[str]) -> None:
    """Apply API schemas by name; those of PhysX and Newton need not be registered to be written."""
    prim.schemas.extend(schemas)


def attribute(prim: Prim, name: str, type_name: str, value: object, *, uniform: bool = False) -> None:
    """Author an attribute of ``prim``; names in ``simfoundry:`` are written as custom, being in no schema."""
    prim.properties[name] = Attribute(type_name, value, uniform)


def connect(prim: Prim, name: str, type_name: str, source: str) -> None:
    """Author an attribute of ``prim`` that is connected to the property at the path ``source``."""
    prim.properties[name] = Attribute(type_name, None, source=source)


def relate(prim: Prim, name: str, targets: Iterable[Prim | str]) -> None:
    """Author a relationship of ``prim`` to others, or to those at paths of the stage."""
    prim.properties[name] = Targets(tuple(t if isinstance(t, str) else t.path for t in targets))


def place(prim: Prim, pose: Pose, scale: Sequence[float] | None = None) -> None:
    """Pose ``prim`` in its parent, in double precision; ``scale`` applies first."""
    operations = []
    p, q = ((), ()) if pose is IDENTITY else (pose.p.tolist(), pose.q.tolist())
    if any(p):
        attribute(prim, "xformOp:translate", "double3", tuple([settled(v) for v in p]))
        operations.append("xformOp:translate")
    if any(q[1:]):
        attribute(prim, "xformOp:orient", "quatd", quat(q))
        operations.append("xformOp:orient")
    if scale is not None:
        attribute(prim, "xformOp:scale", "double3", tuple([rounded(v) for v in scale]))
        operations.append("xformOp:scale")
    if operations:
        attribute(prim, "xformOpOrder", "token[]", operations, uniform=True)


def settled(value: float) -> float:
    """A coordinate [m] or a part of a unit quaternion to twelve decimals, so that what should be zero is zero."""
    return round(float(value), 12) + 0.0


def vec3(values: Iterable[float]) -> tuple[float, ...]:
    """Three numbers for single precision; what that cannot hold is infinite, as a reader will see it."""
    return tuple([v if abs(v) < _MOST else math.copysign(math.inf, v) for v in map(rounded, values)])


_MOST = 3.4028235e38
"""The greatest number of single precision."""


def quat(q: Iterable[float]) -> tuple[float, ...]:
    """A wxyz quaternion to twelve decimals."""
    return tuple([settled(v) for v in q])
