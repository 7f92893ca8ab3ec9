"""The few strokes with which every USD layer is drawn: prims, attributes, relationships, transforms."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache
from typing import TYPE_CHECKING, Any

from simfoundry.backends.artifact import number
from simfoundry.scene.frames import IDENTITY, Pose

if TYPE_CHECKING:
    from pxr import Gf, Sdf


Written = dict[str, dict[str, Any]]
"""Values of attributes, and first targets of relationships, by the path of their prim and their name."""

_written: ContextVar[Written | None] = ContextVar("written", default=None)


@contextmanager
def recorded() -> Iterator[Written]:
    """All that is authored inside the block: what was just written is slow to read back from a layer."""
    written: Written = {}
    token = _written.set(written)
    try:
        yield written
    finally:
        _written.reset(token)


def _record(prim: Sdf.PrimSpec, name: str, value: object) -> None:
    written = _written.get()
    if written is not None:
        written.setdefault(prim.path.pathString, {})[name] = value


@cache
def value_type(name: str) -> Sdf.ValueTypeName:
    """The value type that USD writes as ``name``: ``float``, ``point3f[]`` and so on."""
    from pxr import Sdf

    return Sdf.ValueTypeNames.Find(name)


def define(parent: Sdf.PrimSpec, name: str, type_name: str, schemas: Sequence[str] = ()) -> Sdf.PrimSpec:
    """Define a child prim of a type, with the API schemas applied to it."""
    from pxr import Sdf

    prim = Sdf.PrimSpec(parent, name, Sdf.SpecifierDef, type_name)
    if schemas:
        apply_schemas(prim, schemas)
    return prim


def apply_schemas(prim: Sdf.PrimSpec, schemas: Sequence[str]) -> None:
    """Apply API schemas by name; those of PhysX and Newton need not be registered to be written."""
    from pxr import Sdf

    before = prim.GetInfo("apiSchemas").prependedItems if prim.HasInfo("apiSchemas") else []
    prim.SetInfo("apiSchemas", Sdf.TokenListOp.Create(prependedItems=[*before, *schemas]))


def attribute(prim: Sdf.PrimSpec, name: str, type_name: str, value: object, *, uniform: bool = False) -> None:
    """Author an attribute of ``prim``; names in ``simfoundry:`` are marked as custom, being in no schema."""
    from pxr import Sdf

    variability = Sdf.VariabilityUniform if uniform else Sdf.VariabilityVarying
    custom = name.startswith("simfoundry:")
    spec = Sdf.AttributeSpec(prim, name, value_type(type_name), variability, declaresCustom=custom)
    if value is not None:
        spec.default = value
        _record(prim, name, value)


def connect(prim: Sdf.PrimSpec, name: str, type_name: str, source: str) -> None:
    """Author an attribute of ``prim`` that is connected to the property at the path ``source``."""
    attribute(prim, name, type_name, None)
    prim.attributes[name].connectionPathList.explicitItems = [source]


def relate(prim: Sdf.PrimSpec, name: str, targets: Sequence[Sdf.Path]) -> None:
    """Author a relationship of ``prim`` to the prims at the paths ``targets``, as they are called on the stage."""
    from pxr import Sdf

    paths = [path.StripAllVariantSelections() for path in targets]
    custom = name.startswith("simfoundry:")
    Sdf.RelationshipSpec(prim, name, custom=custom).targetPathList.explicitItems = paths
    _record(prim, name, paths[0] if paths else None)


def place(prim: Sdf.PrimSpec, pose: Pose, scale: Sequence[float] | None = None) -> None:
    """Pose ``prim`` in its parent, in double precision; ``scale`` applies first."""
    from pxr import Gf, Vt

    operations = []
    if pose is not IDENTITY and pose.p.any():
        attribute(prim, "xformOp:translate", "double3", Gf.Vec3d(*(settled(v) for v in pose.p)))
        operations.append("xformOp:translate")
    if pose is not IDENTITY and pose.q[1:].any():
        w, x, y, z = (settled(v) for v in pose.q)
        attribute(prim, "xformOp:orient", "quatd", Gf.Quatd(w, x, y, z))
        operations.append("xformOp:orient")
    if scale is not None:
        attribute(prim, "xformOp:scale", "double3", Gf.Vec3d(*(rounded(v) for v in scale)))
        operations.append("xformOp:scale")
    if operations:
        attribute(prim, "xformOpOrder", "token[]", Vt.TokenArray(operations), uniform=True)


def rounded(value: float) -> float:
    """A number to twelve significant digits: the last bits of a double differ between CPUs."""
    return float(number(value))


def settled(value: float) -> float:
    """A coordinate [m] or a part of a unit quaternion to twelve decimals, so that what should be zero is zero."""
    return round(float(value), 12) + 0.0


def vec3f(values: Iterable[float]) -> Gf.Vec3f:
    """Three numbers in single precision."""
    from pxr import Gf

    return Gf.Vec3f(*(rounded(v) for v in values))


def quatf(q: Iterable[float]) -> Gf.Quatf:
    """A wxyz quaternion in single precision."""
    from pxr import Gf

    w, x, y, z = (settled(v) for v in q)
    return Gf.Quatf(w, x, y, z)
