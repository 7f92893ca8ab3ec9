"""Prims, attributes, relationships and transforms of a stage.

Prims are plain Python objects that :mod:`~simfoundry.backends.usd.usda` converts to text; authoring through USD's own
layers takes five times as long. Vectors, quaternions (w first) and matrix rows are tuples; arrays are lists.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from simfoundry.backends.artifact import rounded
from simfoundry.geometry.frames import IDENTITY, Pose


class Attribute(NamedTuple):
    """A value of a prim and its USD type name; the value is None if there is none or if ``source`` provides it."""

    type_name: str
    value: Any
    uniform: bool = False
    source: str = ""


class Asset(NamedTuple):
    """A file path as the value of an attribute."""

    path: str


class Targets(NamedTuple):
    """The targets of a relationship: paths on the stage."""

    paths: tuple[str, ...]

    @property
    def value(self) -> Targets:
        """Return the targets themselves, for code that reads attributes and relationships alike."""
        return self


@dataclass(eq=False, slots=True)
class Prim:
    """A prim under construction.

    ``path`` is its path on the stage, without variant selections; ``references`` are in USD syntax. A prim with
    ``variants`` has one variant set named ``variant``, with one variant ``selected``; each variant is a prim with its
    own name and type.
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
        """Add the variant ``name``; its contents exist on the stage if the variant is selected."""
        self.variants[name] = Prim(self.name, self.type_name, self.path)
        return self.variants[name]


def define(parent: Prim, name: str, type_name: str, schemas: Sequence[str] = (), specifier: str = "def") -> Prim:
    """Define a child prim of the given type and apply API schemas to it."""
    prim = Prim(name, type_name, f"{parent.path}/{name}", specifier, schemas=list(schemas))
    parent.children[name] = prim
    return prim


def apply_schemas(prim: Prim, schemas: Sequence[str]) -> None:
    """Apply API schemas by name; PhysX and Newton schemas need not be registered."""
    prim.schemas.extend(schemas)


def attribute(prim: Prim, name: str, type_name: str, value: object, *, uniform: bool = False) -> None:
    """Author an attribute of ``prim``; names in ``simfoundry:`` are custom because no schema defines them."""
    prim.properties[name] = Attribute(type_name, value, uniform)


def connect(prim: Prim, name: str, type_name: str, source: str) -> None:
    """Author an attribute of ``prim`` that is connected to the property at the path ``source``."""
    prim.properties[name] = Attribute(type_name, None, source=source)


def relate(prim: Prim, name: str, targets: Iterable[Prim | str]) -> None:
    """Author a relationship from ``prim`` to other prims or stage paths."""
    prim.properties[name] = Targets(tuple(t if isinstance(t, str) else t.path for t in targets))


def place(prim: Prim, pose: Pose, scale: Sequence[float] | None = None) -> None:
    """Set the pose of ``prim`` in its parent, in double precision; ``scale`` applies first."""
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
    """Round a coordinate [m] or quaternion component to twelve decimals, so that rounding noise becomes zero."""
    return round(float(value), 12) + 0.0


def vec3(values: Iterable[float]) -> tuple[float, ...]:
    """Return three values for single precision; values out of its range are infinite, as readers will see them."""
    return tuple([v if abs(v) < _MOST else math.copysign(math.inf, v) for v in map(rounded, values)])


_MOST = 3.4028235e38
"""The largest finite single-precision number."""


def quat(q: Iterable[float]) -> tuple[float, ...]:
    """Return a wxyz quaternion rounded to twelve decimals."""
    return tuple([settled(v) for v in q])
