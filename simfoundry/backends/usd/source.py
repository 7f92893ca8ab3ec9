"""The document behind a scene, kept in the stage, and what the stage said when it was written.

Metadata of prims is composed by USD, so it survives flattening, crates, sublayers and references. In ``customData``,
under ``simfoundry``, the default prim has the document (``document``, without the parts that have a prim of their own)
and each part its own data (``spec``) with its place in the document (``part``): a prim that is copied or deleted takes
them along. ``built`` is what the backend wrote, so that a reader knows what a person changed afterwards.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from simfoundry.scene.source import Source

if TYPE_CHECKING:
    from pxr import Sdf

KEY = "simfoundry"
"""The key of our dictionary in ``customData`` and in ``customLayerData``."""

SCOPES = {"objects": "Objects", "robots": "Robots", "cameras": "Cameras", "lights": "Lights"}
"""Sections of a document whose members have prims, and the scopes below the default prim in which these lie."""

VIEW_ONLY = (
    *("extent", "purpose", "visibility", "xformOp", "semantics:", "info:", "primvars:", "normals", "material:"),
    *("physics:approximation", "faceVarying", "subdivision", "doubleSided", "orientation"),
)
"""Starts of attributes that say how a prim is shown or found; ``at`` has what the transforms come to."""

_DIGITS = 9


def write_source(layer: Sdf.Layer, source: Source) -> None:
    """Write ``source`` into the prims of a finished ``layer``, whose default prim is there."""
    world = layer.GetPrimAtPath(f"/{layer.defaultPrim}")
    document = dict(source.data)
    for section, scope in SCOPES.items():
        members = dict(document.get(section, {}))
        for name, data in members.items():
            prim = layer.GetPrimAtPath(f"{world.path}/{scope}/{name}")
            if prim:
                part = {"part": f"{section}.{name}", "spec": _lines(data), "built": _lines(built(prim))}
                _add(prim, part)
                members[name] = None
        if members:
            document[section] = members
    about = {"kind": source.kind, "file": source.file, "digest": source.digest}
    _add(world, {**about, "document": _lines(document)})
    layer.pseudoRoot.SetInfo("customLayerData", {KEY: about})


def built(part: Sdf.PrimSpec) -> dict[str, dict[str, Any]]:
    """What ``part`` and the prims below it say, by path relative to it; of itself by the empty path."""
    values = {}
    for prim in _subtree(part):
        relative = str(prim.path.MakeRelativePath(part.path)) if prim != part else ""
        said = observed({name: attribute.default for name, attribute in prim.attributes.items()})
        said |= _bound(prim)
        at = _transform(prim)
        if at is not None:
            said["at"] = at
        if said:
            values[relative] = said
    return values


def observed(attributes: Mapping[str, Any]) -> dict[str, Any]:
    """The values among those of a prim's attributes that mean something to the document, as plain data."""
    said = {}
    for name in sorted(attributes):
        value = plain(attributes[name])
        if value is not None and not name.startswith(VIEW_ONLY):
            said[name] = value
    return said


def plain(value: Any) -> Any:
    """A value of USD as plain data: numbers to nine digits, vectors and quaternions (w first) as lists.

    None for all else, arrays among it.
    """
    match value:
        case bool() | int():
            return value
        case float():
            return float(format(value, f".{_DIGITS}g"))
        case str():
            return str(value)
    kind = type(value).__name__
    if kind.endswith("Array"):
        return None
    if kind.startswith("Quat"):
        return [plain(float(v)) for v in (value.GetReal(), *value.GetImaginary())]
    return [plain(v) for v in value] if kind.startswith("Vec") else None


def _subtree(prim: Sdf.PrimSpec) -> Iterator[Sdf.PrimSpec]:
    yield prim
    for child in prim.nameChildren:
        yield from _subtree(child)


def _transform(prim: Sdf.PrimSpec) -> list[float] | None:
    """Position, quaternion and scale of a prim in its parent; None where it is the identity."""
    found = [
        [0.0, 0.0, 0.0] if (p := prim.attributes.get("xformOp:translate")) is None else plain(p.default),
        [1.0, 0.0, 0.0, 0.0] if (q := prim.attributes.get("xformOp:orient")) is None else plain(q.default),
        [1.0, 1.0, 1.0] if (s := prim.attributes.get("xformOp:scale")) is None else plain(s.default),
    ]
    return None if p is None and q is None and s is None else [v for values in found for v in values]


def _bound(prim: Sdf.PrimSpec) -> dict[str, Any]:
    """How a shape looks and touches: values of the materials that are bound to it."""
    said: dict[str, Any] = {}
    for relationship, key in (("material:binding", "look"), ("material:binding:physics", "contact")):
        bound = prim.relationships.get(relationship)
        if bound is not None:
            material = prim.layer.GetPrimAtPath(bound.targetPathList.explicitItems[0])
            said[key] = look(_values(material)) if key == "look" else contact(_values(material)[""])
    return said


def _values(material: Sdf.PrimSpec) -> dict[str, dict[str, Any]]:
    """The attributes of a material and of its shaders, by name."""
    prims = {"": material, **{child.name: child for child in material.nameChildren}}
    return {name: {key: a.default for key, a in prim.attributes.items()} for name, prim in prims.items()}


def look(material: Mapping[str, Mapping[str, Any]]) -> list[float] | None:
    """Scene-linear red, green, blue, and opacity of a material of ours; a texture is multiplied by them.

    ``material`` has the attributes of its shaders by the shaders' names. None where it is not of our making any more.
    """
    surface, texture = material.get("Surface", {}), material.get("Texture", {})
    color = texture.get("inputs:scale") if texture else surface.get("inputs:diffuseColor")
    opacity = surface.get("inputs:opacity")
    return None if color is None or opacity is None else [*plain(color)[:3], plain(opacity)]


def contact(material: Mapping[str, Any]) -> list[float] | None:
    """Friction and restitution of a contact material, each as PhysX has it and as the surface's own."""
    names = ("physics:dynamicFriction", f"{KEY}:friction", "physics:restitution", f"{KEY}:restitution")
    values = [plain(material.get(name)) for name in names]
    return None if None in values else values


def _lines(data: Mapping[str, Any]) -> str:
    """JSON with a line for each key of the outermost mapping, for people who look at the metadata."""
    entries = [f"{json.dumps(key)}: {json.dumps(value, ensure_ascii=False)}" for key, value in data.items()]
    return "{" + ",\n ".join(entries) + "}"


def _add(prim: Sdf.PrimSpec, entries: Mapping[str, str]) -> None:
    custom = dict(prim.customData)
    prim.SetInfo("customData", {**custom, KEY: {**custom.get(KEY, {}), **entries}})
