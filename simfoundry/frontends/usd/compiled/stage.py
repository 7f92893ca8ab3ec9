"""Access to the document of a compiled stage, its members, and the current values of their prims."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from simfoundry.backends.usd.source import KEY, SCOPES, contact, look, observed, plain
from simfoundry.errors import SimfoundryError
from simfoundry.geometry.frames import Array, Pose, quat_from_matrix
from simfoundry.spec.models.scene import SceneSpec
from simfoundry.spec.models.types import with_present_keys

if TYPE_CHECKING:
    from pxr import Usd, UsdGeom

    from simfoundry.frontends.usd.compiled.stage_frame import StageFrame

# Name of the variant set of an object.
VARIANTS = "variant"

# Placeholder for a variant that was not compiled; not a valid variant name.
UNKNOWN = "?"

# Relationships that determine the visual and contact materials in :func:`_now`.
_BINDINGS = {"look": "material:binding", "contact": "material:binding:physics"}

# Values by prim path relative to the member, and then by name.
Values = dict[str, dict[str, Any]]

# The identity transform as stored under ``at``: a position, a quaternion (w first), and a scale.
_IDENTITY = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0)


class StageError(SimfoundryError):
    """Raised if a file is not a stage or cannot be read as a document.

    ``reason`` does not include the file name.
    """

    def __init__(self, reason: str, file: Path | None = None) -> None:
        super().__init__(reason if file is None else f"{file}: {reason}")
        self.reason = reason


@dataclass(frozen=True)
class StageNote:
    """A note about stage content that the document cannot express, with the prim path, a message, and a hint."""

    prim: str
    message: str
    hint: str = ""


class Edited(NamedTuple):
    """The data of a stage member after edits, with notes on unsupported edits."""

    data: dict[str, Any]
    notes: tuple[StageNote, ...]


@dataclass(frozen=True)
class StageMember:
    """A member of a document section, such as an object, with the prim that represents it.

    ``spec`` is the member's data, ``built`` contains the values of its prims as compiled, and ``now`` contains their
    current values. ``X_WP`` is the pose of the prim in the world, and ``scale`` is its scale along each axis, shape
    (3,). If an object has variants, these fields describe the selected ``variant``, whose name is `?` if it was not
    compiled. ``others`` describes the remaining variants; only opinions in such a variant itself count as edits to it.
    ``stage`` keeps ``prim`` alive, because a prim has only a weak reference to its stage.
    """

    section: str
    name: str
    prim: Usd.Prim
    spec: dict[str, Any]
    built: Values
    now: Values
    X_WP: Pose
    scale: Array
    variant: str = ""
    others: tuple[StageMember, ...] = ()
    stage: Usd.Stage | None = None

    @property
    def path(self) -> str:
        """The path of the member's prim."""
        return str(self.prim.GetPath())

    @property
    def X_WP_built(self) -> Pose:
        """The pose of the member in the world as compiled."""
        return local_pose(self.built, "")


def open_stage(path: Path) -> Usd.Stage:
    """Open a stage.

    Raises:
        StageError: If the file is missing or is not a stage.
    """
    from pxr import Tf, Usd

    if not path.is_file():
        raise StageError("the file does not exist", path)
    try:
        return Usd.Stage.Open(str(path))
    except Tf.ErrorException as error:
        reason = error_text(error).strip().splitlines()[-1].partition(": ")[2].strip(" '\"")
        raise StageError(f"USD could not read the file as a stage: {reason}", path) from None


def error_text(error: Exception) -> str:
    """Return the message of an OpenUSD error, which may contain invalid UTF-8 from the file."""
    try:
        return str(error)
    except UnicodeDecodeError as undecoded:
        return undecoded.object.decode("utf-8", "replace")


def carrier(stage: Usd.Stage) -> Usd.Prim | None:
    """Return the prim that contains the document, preferably the default prim, or None if there is none."""
    return next((p for p in [stage.GetDefaultPrim(), *stage.Traverse()] if p and "document" in _entries(p)), None)


def document(prim: Usd.Prim) -> tuple[str, dict[str, Any]]:
    """Return a document's path within its project, and its data excluding that of its members."""
    entries = _entries(prim)
    return str(entries.get("file", "")), with_present_keys(SceneSpec, _json(prim, "document", _checked_sections))


def parts(stage: Usd.Stage, world: StageFrame) -> list[StageMember]:
    """Return all active members in stage order, including members that were moved within the hierarchy."""
    found = [_part(prim, world) for prim in stage.Traverse() if "part" in _entries(prim)]
    others = _other_variants(stage, [part for part in found if part.variant], world)
    return [replace(part, others=others.get(part.path, ())) for part in found]


def _other_variants(
    stage: Usd.Stage, varied: list[StageMember], world: StageFrame
) -> dict[str, tuple[StageMember, ...]]:
    """Return the members for all unselected variants, keyed by path.

    The stage is opened repeatedly, each time with a different variant of every object, until all variants are covered.
    """
    from pxr import Sdf, Usd

    rest: dict[str, list[str]] = {}
    for part in varied:
        choices = part.prim.GetVariantSet(VARIANTS)
        rest[part.path] = [name for name in choices.GetVariantNames() if name != choices.GetVariantSelection()]
    found: dict[str, list[StageMember]] = {path: [] for path in rest}
    for k in range(max(map(len, rest.values()), default=0)):
        other = Usd.Stage.Open(stage.GetRootLayer(), Sdf.Layer.CreateAnonymous())
        chosen = {path: names[k] for path, names in rest.items() if k < len(names)}
        with Usd.EditContext(other, other.GetSessionLayer()):
            for path, name in chosen.items():
                other.GetPrimAtPath(path).GetVariantSet(VARIANTS).SetVariantSelection(name)
        elsewhere = world.anew()
        for path in chosen:
            part = _part(other.GetPrimAtPath(path), elsewhere)
            if part.variant != UNKNOWN:
                now = _own_opinions(part)
                found[path].append(replace(part, now=now, X_WP=part.X_WP_built, scale=np.ones(3), stage=other))
    return {path: tuple(parts) for path, parts in found.items()}


def _own_opinions(part: StageMember) -> Values:
    """Return the values of a variant's prims.

    The compiled value is used if the strongest opinion is not in the variant.
    """
    now: Values = {}
    for relative in dict.fromkeys((*part.built, *part.now)):
        prim = part.prim.GetPrimAtPath(relative) if relative else part.prim
        built, now_values = part.built.get(relative), part.now.get(relative)
        if now_values is None:  # deleted, possibly for all variants, so this is not an edit of the variant
            verdicts = [spec for spec in prim.GetPrimStack() if spec.HasInfo("active")] if prim else []
            if built is not None and verdicts and not _in_variant(verdicts[0]):
                now[relative] = built
        elif built is not None or any(_in_variant(spec) for spec in prim.GetPrimStack()):
            kept = {name: value for name, value in now_values.items() if _is_own(prim, name)}
            now[relative] = {n: v for n, v in (built or {}).items() if n not in kept and not _is_own(prim, n)} | kept
    return now


def _is_own(prim: Usd.Prim, name: str) -> bool:
    """Return True if the strongest opinion for a value in :func:`_now` comes from a variant or does not exist."""
    from pxr import Usd, UsdGeom

    if name == "at":
        operations = [op.GetAttr() for op in UsdGeom.Xformable(prim).GetOrderedXformOps()]
        properties = [*operations, prim.GetAttribute("xformOpOrder")]
    else:
        properties = [prim.GetProperty(_BINDINGS.get(name, name))]
    stacks = [found.GetPropertyStack(Usd.TimeCode.Default()) for found in properties if found]
    return all(_in_variant(stack[0]) for stack in stacks if stack)


def _in_variant(spec: Any) -> bool:
    return bool(spec.path.ContainsPrimVariantSelection())


def transform(values: Values, path: str) -> Array:
    """Return the transform of a prim relative to its parent.

    Returns:
        The position, the quaternion (w first) and the scale in one array, shape (10,).
    """
    return np.array(values.get(path, {}).get("at") or _IDENTITY, dtype=np.float64)


def local_pose(values: Values, path: str) -> Pose:
    """Return the pose of a prim relative to its parent, without its scale."""
    at = transform(values, path)
    return Pose.of(at[:3], at[3:7])


def factored(matrix: Any) -> tuple[Pose, Array]:
    """Decompose a USD transform, which multiplies row vectors, into a pose and a scale.

    Mirroring becomes a negative scale along z. If the scale is zero along an axis, the rotation is the identity.
    """
    m = np.array(matrix, dtype=np.float64)
    scale = np.linalg.norm(m[:3, :3], axis=1)
    if not np.isfinite(m).all() or scale.min() < 1e-12:
        return Pose.of(m[3, :3] if np.isfinite(m[3, :3]).all() else np.zeros(3)), scale
    rows = m[:3, :3] / scale[:, None]
    if np.linalg.det(rows) < 0:
        scale[2], rows[2] = -scale[2], -rows[2]
    return Pose.of(m[3, :3], quat_from_matrix(rows.T)), scale


def links_of(built: Values) -> list[str]:
    """Return the relative paths of an object's compiled links, with the root first."""
    return [path for path, values in built.items() if path and "/" not in path and "physics:mass" in values]


def _part(prim: Usd.Prim, world: StageFrame) -> StageMember:
    section, _, name = str(_entries(prim)["part"]).partition(".")
    if section not in SCOPES or not name:
        raise StageError(f"{prim.GetPath()}: its metadata does not refer to a member of a scene")
    spec = with_present_keys(SceneSpec.model_fields[section].annotation, {name: _json(prim, "spec")})[name]
    if spec.get("variants") and "variant" not in _entries(prim):  # added by a user
        return StageMember(section, name, prim, spec, {}, {}, Pose.of(), np.ones(3), UNKNOWN)
    built = _json(prim, "built", _checked_values)
    links = links_of(built) if section == "objects" else []
    root = prim.GetChild(links[0]) if links else prim  # simulators move the body, users move the object
    X_WP, scale = factored(world.matrix(root or prim))
    variant = str(_entries(prim)["variant"]) if spec.get("variants") else ""
    return StageMember(section, name, prim, spec, built, _now(prim, built, world.cache), X_WP, scale, variant)


def _entries(prim: Usd.Prim) -> Mapping[str, Any]:
    entries = prim.GetCustomDataByKey(KEY)
    return entries if isinstance(entries, dict) else {}


def _json(prim: Usd.Prim, key: str, check: Any = None) -> dict[str, Any]:
    """Return a mapping that is stored as JSON in a prim's metadata."""
    try:
        data = _tuples(json.loads(str(_entries(prim)[key])))
        if not isinstance(data, dict):
            raise ValueError
        if check is not None:
            check(data)
    except (KeyError, ValueError, TypeError, RecursionError):
        message = f"{prim.GetPath()}: could not parse its metadata `{KEY}:{key}`; was it edited by hand?"
        raise StageError(message) from None
    return data


def _checked_sections(data: dict[str, Any]) -> None:
    if any(not isinstance(data.get(section, {}), dict) for section in SCOPES):
        raise ValueError


def _checked_values(data: dict[str, Any]) -> None:
    for values in data.values():
        if not isinstance(values, dict) or transform({"": values}, "").shape != (10,):
            raise ValueError
        local_pose({"": values}, "")  # raises ValueError for a quaternion of zero length


def _tuples(data: Any) -> Any:
    """Replace lists with tuples, as in documents."""
    if isinstance(data, dict):
        return {key: _tuples(value) for key, value in data.items()}
    return tuple(_tuples(value) for value in data) if isinstance(data, list) else data


def _now(part: Usd.Prim, built: Values, cache: UsdGeom.XformCache) -> Values:
    """Return the current values of a member's prims, in the format of :mod:`simfoundry.backends.usd.source`."""
    from pxr import Usd, UsdGeom

    values: Values = {}
    robot = str(_entries(part)["part"]).startswith("robots.")  # its model is separate and large
    known = [part, *(part.GetPrimAtPath(path) for path in built if path)]
    for prim in [p for p in known if p] if robot else Usd.PrimRange(part):
        relative = "" if prim == part else str(prim.GetPath().MakeRelativePath(part.GetPath()))
        now_values = observed(_attributes(prim))
        now_values |= _bound(prim, built.get(relative, {}))
        if prim.IsA(UsdGeom.Xformable):
            pose, scale = factored(cache.GetLocalTransformation(prim)[0])
            now_values["at"] = (*pose.p.tolist(), *pose.q.tolist(), *scale.tolist())
        values[relative] = _tuples(now_values)
    return values


def _attributes(prim: Usd.Prim) -> dict[str, Any]:
    """Return the authored attribute values of a prim, keyed by name.

    Animated attributes are represented by their first value.
    """
    from pxr import Usd

    return {a.GetName(): a.Get(Usd.TimeCode.EarliestTime()) for a in prim.GetAuthoredAttributes() if a.HasValue()}


def fallback(prim: Usd.Prim, name: str) -> Any:
    """Return the fallback value of an attribute as plain data, or None if its schema is unknown."""
    return plain(prim.GetPrimDefinition().GetAttributeFallbackValue(name))


def _bound(prim: Usd.Prim, built: Mapping[str, Any]) -> dict[str, Any]:
    """Return a shape's current visual and contact materials, limited to the kinds with which it was ``built``."""
    from pxr import UsdShade

    now_values: dict[str, Any] = {}
    api = UsdShade.MaterialBindingAPI(prim)
    if "look" in built:
        visual, _ = api.ComputeBoundMaterial()
        shaders = visual.GetPrim().GetChildren() if visual else []
        now_values["look"] = look({child.GetName(): _attributes(child) for child in shaders})
    if "contact" in built:
        physics, _ = api.ComputeBoundMaterial("physics")
        values = _attributes(physics.GetPrim()) if physics else {}
        now_values["contact"] = contact(_with_own(values)) if "physics:dynamicFriction" in values else None
    return now_values


def _with_own(material: dict[str, Any]) -> dict[str, Any]:
    """Add the surface's own coefficients to a contact material, because only compiled materials include them."""
    out = {"physics:restitution": 0.0, **material}
    for name, source in (("friction", "physics:dynamicFriction"), ("restitution", "physics:restitution")):
        value = plain(out[source])
        own = value * value if material.get(f"physxMaterial:{name}CombineMode") == "multiply" else value
        out.setdefault(f"{KEY}:{name}", own)
    return out
