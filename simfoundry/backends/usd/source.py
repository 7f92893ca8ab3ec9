"""The document behind a scene, kept in the stage, and what the stage said when it was written.

Metadata of prims is composed by USD, so it survives flattening, crates, sublayers and references. In ``customData``,
under ``simfoundry``, the default prim has the document (``document``, without the parts that have a prim of their own)
and each part its own data (``spec``) with its place in the document (``part``): a prim that is copied or deleted takes
them along. ``built`` is what the backend wrote, so that a reader knows what a person changed afterwards. Of an object
with variants each variant has its own ``built``, and its name as ``variant``: the stage shows those of the chosen one.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Any

from simfoundry.backends.artifact import json_line, json_string
from simfoundry.backends.usd.prims import Prim
from simfoundry.scene.source import Source

KEY = "simfoundry"
"""The key of our dictionary in ``customData`` and in ``customLayerData``."""

SCOPES = {"objects": "Objects", "robots": "Robots", "cameras": "Cameras", "lights": "Lights"}
"""Sections of a document whose members have prims, and the scopes below the default prim in which these lie."""

VIEW_ONLY = (
    *("extent", "purpose", "visibility", "xformOp", "semantics:", "info:", "primvars:", "normals", "material:"),
    *("physics:approximation", "faceVarying", "subdivision", "doubleSided", "orientation"),
)
"""Starts of attributes that say how a prim is shown or found; ``at`` has what the transforms come to."""

_NUMBER = "%.9g"


def write_source(world: Prim, source: Source) -> dict[str, str]:
    """Write ``source`` into the prims from the finished default prim down; returns what the layer says about it."""
    document = dict(source.data)
    materials = _materials(world)
    for section, scope in SCOPES.items():
        members = dict(document.get(section, {}))
        prims = world.children[scope].children if scope in world.children else {}
        for name, data in members.items():
            if name in prims:
                _add(prims[name], {"part": f"{section}.{name}", "spec": _lines(data)})
                for variant, prim in (prims[name].variants or {"": prims[name]}).items():
                    said: dict[str, dict[str, Any]] = {}
                    _collect(prim, "", materials, said)
                    said = _posture(said) if section == "robots" else said
                    _add(prim, ({"variant": variant} if variant else {}) | {"built": _lines(said)})
                members[name] = None
        if members:
            document[section] = members
    about = {"kind": source.kind, "file": source.file, "digest": source.digest}
    _add(world, {**about, "document": _lines(document)})
    return about


def _collect(prim: Prim, path: str, materials: Mapping[str, Any], said_by: dict[str, dict[str, Any]]) -> None:
    """Collect what a part and the prims below it say, by ``path`` relative to it; of itself by the empty path."""
    values = _values(prim)
    said = observed(values)
    for binding, name in _BINDINGS.items():
        if binding in values:
            said[name] = materials.get(values[binding].paths[0])
    if "xformOpOrder" in values:
        said["at"] = _transform(values)
    if said:
        said_by[path] = said
    for name, child in prim.children.items():
        _collect(child, f"{path}/{name}" if path else name, materials, said_by)


def _values(prim: Prim) -> dict[str, Any]:
    """Return the values of the properties of a prim, without attributes that have none."""
    return {name: found.value for name, found in prim.properties.items() if found.value is not None}


_BINDINGS = {"material:binding": "look", "material:binding:physics": "contact"}
"""How a shape looks and touches: relationships to the materials that are bound to it, and what we call these."""


def _materials(world: Prim) -> dict[str, Any]:
    """Return the values of the materials of the stage, by their path."""
    looks, contacts = (world.children[scope].children.values() for scope in ("Looks", "Contacts"))
    shaders = {p.path: {name: _values(shader) for name, shader in p.children.items()} for p in looks}
    return {path: look(found) for path, found in shaders.items()} | {p.path: contact(_values(p)) for p in contacts}


def _posture(said: Mapping[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Return the pose and joint positions alone from the values of a robot's prims: its model is its own."""
    states = {path: {n: v for n, v in values.items() if n.startswith("state:")} for path, values in said.items()}
    base = {"": {"at": said[""]["at"]}} if "at" in said.get("", {}) else {}
    return base | {path: values for path, values in states.items() if values}


def observed(attributes: Mapping[str, Any]) -> dict[str, Any]:
    """The values among those of a prim's attributes that mean something to the document, as plain data."""
    said = {}
    for name in sorted(attributes):
        if not _is_view_only(name) and (value := plain(attributes[name])) is not None:
            said[name] = value
    return said


@lru_cache(maxsize=1024)
def _is_view_only(name: str) -> bool:
    return name.startswith(VIEW_ONLY)


def plain(value: Any) -> Any:
    """A value of USD as plain data: numbers to nine digits, vectors and quaternions (w first) as lists.

    None for all else, arrays among it.
    """
    match value:
        case float():
            return float(_NUMBER % value)
        case str():
            return str(value)
        case bool() | int():
            return value
        case tuple() if value and isinstance(value[0], float | int):
            return [v if type(v) is int else float(_NUMBER % v) for v in value]
    kind = type(value).__name__
    if kind.endswith("Array"):
        return None
    if kind.startswith("Quat"):
        return [float(_NUMBER % v) for v in (value.GetReal(), *value.GetImaginary())]
    if kind.startswith("Vec"):  # by index: to iterate, pxr raises and translates an error at the end
        values = [value[k] for k in range(len(value))]
        return [v if type(v) is int else float(_NUMBER % v) for v in values]
    return None


def _transform(values: Mapping[str, Any]) -> list[float]:
    """Position, quaternion and scale of a prim in its parent."""
    position, turn, scale = (values.get(f"xformOp:{name}") for name in ("translate", "orient", "scale"))
    return [
        *([0.0, 0.0, 0.0] if position is None else plain(position)),
        *([1.0, 0.0, 0.0, 0.0] if turn is None else plain(turn)),
        *([1.0, 1.0, 1.0] if scale is None else plain(scale)),
    ]


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
    entries = [f"{json_string(key)}: {json_line(value)}" for key, value in data.items()]
    return "{" + ",\n ".join(entries) + "}"


def _add(prim: Prim, entries: Mapping[str, str]) -> None:
    prim.custom_data.setdefault(KEY, {}).update(entries)
