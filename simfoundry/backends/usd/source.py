"""Storage of a scene's source document in the stage, along with a record of the stage as written by the backend.

The data is stored in prim metadata. USD composes this metadata, so it survives flattening, crates, sublayers and
references. In ``customData`` under ``simfoundry``, the default prim stores the document without the parts that have
their own prims (``document``). Each part stores its own data (``spec``) and its path in the document (``part``), so
copying or deleting a prim also copies or deletes its data. ``built`` records the values written by the backend, which
allows readers to detect later edits. If an object has variants, each variant has its own ``built`` record and its name
in ``variant``; the composed stage contains the entries of the selected variant.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

from simfoundry.backends.artifact import json_line, json_string
from simfoundry.backends.usd.prims import Prim
from simfoundry.scene.model import Source

# The key of SimFoundry's dictionary in ``customData`` and ``customLayerData``.
KEY = "simfoundry"

# Document sections whose entries have prims, with the name of each section's scope below the default prim.
SCOPES = {"objects": "Objects", "robots": "Robots", "cameras": "Cameras", "lights": "Lights"}

# Prefixes of attributes that affect only display or lookup. Transforms are stored separately, under ``at``.
VIEW_ONLY = (
    *("extent", "purpose", "visibility", "xformOp", "semantics:", "info:", "primvars:", "normals", "material:"),
    *("physics:approximation", "faceVarying", "subdivision", "doubleSided", "orientation"),
)

_NUMBER = "%.9g"


def write_source(world: Prim, source: Source) -> dict[str, str]:
    """Store ``source`` in the complete default prim and its descendants, and return the layer metadata."""
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
    digest = hashlib.sha256(json.dumps(dict(source.data), ensure_ascii=False).encode()).hexdigest()
    about = {"kind": str(source.data["simfoundry"]), "file": source.file, "digest": digest}
    _add(world, {**about, "document": _lines(document)})
    return about


def _collect(prim: Prim, path: str, materials: Mapping[str, Any], said_by: dict[str, dict[str, Any]]) -> None:
    """Collect the values of a part and its descendant prims by relative path, which is empty for the part itself."""
    values = _values(prim)
    said = observed(values)
    for binding, name in _BINDINGS.items():
        if binding in values:
            said[name] = materials.get(values[binding][0])
    if "xformOpOrder" in values:
        said["at"] = _transform(values)
    if said:
        said_by[path] = said
    for name, child in prim.children.items():
        _collect(child, f"{path}/{name}" if path else name, materials, said_by)


def _values(prim: Prim) -> dict[str, Any]:
    """Return the property values of a prim, omitting attributes without a value."""
    return {name: found.value for name, found in prim.properties.items() if found.value is not None}


# Material bindings for appearance and contact, with the names under which they are recorded.
_BINDINGS = {"material:binding": "look", "material:binding:physics": "contact"}


def _materials(world: Prim) -> dict[str, Any]:
    """Return the values of all materials on the stage, keyed by path."""
    looks, contacts = (world.children[scope].children.values() for scope in ("Looks", "Contacts"))
    shaders = {p.path: {name: _values(shader) for name, shader in p.children.items()} for p in looks}
    return {path: look(found) for path, found in shaders.items()} | {p.path: contact(_values(p)) for p in contacts}


def _posture(said: Mapping[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Keep only the pose and joint positions of a robot's prims, because its model is stored separately."""
    states = {path: {n: v for n, v in values.items() if n.startswith("state:")} for path, values in said.items()}
    base = {"": {"at": said[""]["at"]}} if "at" in said.get("", {}) else {}
    return base | {path: values for path, values in states.items() if values}


def observed(attributes: Mapping[str, Any]) -> dict[str, Any]:
    """Return the attribute values that are relevant to the document, as plain data."""
    said = {}
    for name in sorted(attributes):
        if not _is_view_only(name) and (value := plain(attributes[name])) is not None:
            said[name] = value
    return said


@lru_cache(maxsize=1024)
def _is_view_only(name: str) -> bool:
    return name.startswith(VIEW_ONLY)


def plain(value: Any) -> Any:
    """Convert a USD value to plain data, with nine-digit numbers, and lists for vectors and quaternions (w first).

    Returns None for all other types, including arrays.
    """
    kind = type(value).__name__
    if kind.endswith("Array"):
        return None
    if kind.startswith("Quat"):
        value = (value.GetReal(), *value.GetImaginary())
    elif kind.startswith("Vec"):  # indexing is faster, because pxr ends iterations with a translated exception
        value = tuple([value[k] for k in range(len(value))])
    match value:
        case float():
            return float(_NUMBER % value)
        case str():
            return str(value)
        case bool() | int():
            return value
        case tuple() if value and isinstance(value[0], float | int):
            return [v if type(v) is int else float(_NUMBER % v) for v in value]
    return None


def _transform(values: Mapping[str, Any]) -> list[float]:
    """Return a prim's position, quaternion and scale relative to its parent."""
    position, turn, scale = (values.get(f"xformOp:{name}") for name in ("translate", "orient", "scale"))
    return [
        *([0.0, 0.0, 0.0] if position is None else plain(position)),
        *([1.0, 0.0, 0.0, 0.0] if turn is None else plain(turn)),
        *([1.0, 1.0, 1.0] if scale is None else plain(scale)),
    ]


def look(material: Mapping[str, Mapping[str, Any]]) -> list[float] | None:
    """Return the scene-linear red, green, blue and opacity by which a material multiplies any texture.

    ``material`` contains the shader attributes, keyed by shader name. Returns None if the material no longer has the
    structure that this backend writes.
    """
    surface, texture = material.get("Surface", {}), material.get("Texture", {})
    color = texture.get("inputs:scale") if texture else surface.get("inputs:diffuseColor")
    opacity = surface.get("inputs:opacity")
    return None if color is None or opacity is None else [*plain(color)[:3], plain(opacity)]


def contact(material: Mapping[str, Any]) -> list[float] | None:
    """Return the friction and the restitution of a contact material.

    For both quantities, the value for PhysX is followed by the value of the surface itself.
    """
    names = ("physics:dynamicFriction", f"{KEY}:friction", "physics:restitution", f"{KEY}:restitution")
    values = [plain(material.get(name)) for name in names]
    return None if None in values else values


def _lines(data: Mapping[str, Any]) -> str:
    """Format JSON with one line per top-level key to keep the metadata readable."""
    entries = [f"{json_string(key)}: {json_line(value)}" for key, value in data.items()]
    return "{" + ",\n ".join(entries) + "}"


def _add(prim: Prim, entries: Mapping[str, str]) -> None:
    prim.custom_data.setdefault(KEY, {}).update(entries)
