"""Descriptions of the parts of a scene: objects, joints, materials, cameras, frames and files, as Markdown."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from simfoundry.geometry.frames import Array, Pose, rpy_from_quat
from simfoundry.language_server.display.markdown import code_span, escaped
from simfoundry.lint.contacts import HOVERING, supports
from simfoundry.lint.draft import DraftScene
from simfoundry.lint.views import sees
from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.lengths import length
from simfoundry.scene.lengths import number as coordinate
from simfoundry.scene.mass_facts import MassFacts, link_mass, mass_source, object_mass
from simfoundry.scene.model import Camera, Joint, JointType, Link, SceneObject, pair_friction
from simfoundry.scene.object_shapes import bounds, geometry_bounds
from simfoundry.spec.files import Loaded
from simfoundry.spec.models.base import Material
from simfoundry.spec.models.predicate import parse_call

# Longest list of names in a description; a longer one ends with the number of the others.
MOST_NAMES = 8

Rows = list[tuple[str, str]]


def object_text(loaded: Loaded, draft: DraftScene, name: str) -> str:
    """Describe an object: what it is, its mass, its size, its pose, and on what it rests."""
    item = draft.scene.by_name[name]
    rows = _mass_rows(object_mass(item), mass_source(loaded, item), item.fixed)
    low, high = bounds(item)
    rows.insert(1, ("size", _size(high - low)))
    if name in draft.unplaced:
        rows.append(("pose", "known once the meshes around it have been decomposed"))
    else:
        rows += pose_rows(item.X_WO)
        if below := support_names(draft, item):
            rows.append(("rests on", _names(below)))
    rows += [(f"joint {joint.name}", _joint_state(joint)) for joint in _moving(item)[:MOST_NAMES]]
    return f"{_title(name, _kind_words(draft, item))}\n\n{_aligned(rows)}"


def link_text(loaded: Loaded, draft: DraftScene, name: str, part: str) -> str | None:
    """Describe a link of an object, or return None if the object has no such link."""
    item = draft.scene.by_name[name]
    link = next((link for link in item.links if link.name == part), None)
    if link is None:
        return None
    rows = _mass_rows(link_mass(link), mass_source(loaded, item, part), item.fixed)
    rows.insert(1, ("size", _size(_link_extent(link))))
    if name not in draft.unplaced:
        rows += pose_rows(item.X_WO @ link_poses(item)[part])
    above = item.joints_above.get(part, ())
    rows += [("moved by", f"{joint.name}, {_joint_state(joint)}") for joint in above]
    return f"{_title(f'{name}.{part}', [f'link of `{name}`'])}\n\n{_aligned(rows)}"


def asset_link_text(loaded: Loaded, item: SceneObject, part: str) -> str | None:
    """Describe a link of an asset document, or return None if it has no such link."""
    link = next((link for link in item.links if link.name == part), None)
    if link is None:
        return None
    rows = _mass_rows(link_mass(link), mass_source(loaded, item, part), False)
    rows.insert(1, ("size", _size(_link_extent(link))))
    rows += [("moved by", f"{joint.name}, {_joint_state(joint)}") for joint in item.joints_above.get(part, ())]
    return f"{_title(part, ['link'])}\n\n{_aligned(rows)}"


def joint_text(owner: str, joint: Joint) -> str:
    """Describe a joint of an object."""
    rows: Rows = [("type", joint.type.value), ("moves", f"{joint.child}, relative to {joint.parent}")]
    if joint.has_axis:
        rows.append(("axis", f"[{', '.join(coordinate(float(v)) for v in joint.axis)}] in {joint.child}"))
        rows.append(("range", _limits(joint)))
        rows.append(("position", _position(joint, joint.position)))
        rows.append(("closed at", _position(joint, joint.closed_position)))
    unit = "N m" if joint.type is not JointType.PRISMATIC else "N"
    if joint.mimic is not None:
        rows.append(("follows", f"{joint.mimic.joint} × {joint.mimic.multiplier:.4g} + {joint.mimic.offset:.4g}"))
    if joint.damping:
        rows.append(("damping", f"{joint.damping:.4g} {unit} s/{'rad' if unit == 'N m' else 'm'}"))
    if joint.friction:
        rows.append(("friction", f"{joint.friction:.4g} {unit}"))
    if joint.effort is not None:
        rows.append(("effort", f"at most {joint.effort:.4g} {unit}"))
    name = f"{owner}.{joint.name}" if owner else joint.name
    return f"{_title(name, ['joint'])}\n\n{_aligned(rows)}"


def material_text(name: str, material: Material, draft: DraftScene | None) -> str:
    """Describe a material, the objects that it is used for, and the friction of its pairs with other materials."""
    rows: Rows = [
        ("density", f"{material.density:.4g} kg/m³" if material.density is not None else "not given"),
        ("friction", f"{material.friction:.4g}"),
        ("restitution", f"{material.restitution:.4g}"),
    ]
    if draft is not None:
        users, others = list[str](), dict[str, float]()
        for item in draft.scene.objects:
            colliders = [collider for link in item.links for collider in link.colliders]
            if any(collider.material == name for collider in colliders):
                users.append(item.name)
            others |= {c.material: c.friction for c in colliders if c.material in draft.spec.materials}
        rows.append(("used by", _names(users) if users else "nothing"))
        for other in list(others)[:MOST_NAMES]:
            mu = pair_friction(material.friction, draft.spec.materials[other].friction)
            rows.append((f"on {other}", f"μ = {mu:.3g}, slides above {math.degrees(math.atan(mu)):.1f}°"))
    return f"{_title(name, ['material'])}\n\n{_aligned(rows)}"


def camera_text(name: str, draft: DraftScene) -> str | None:
    """Describe a camera and what it sees at the start, or return None if its pose is not known."""
    camera = draft.cameras.get(name)
    if camera is None:
        return None
    view = tuple(math.degrees(2 * math.atan(px / 2 / focal)) for px, focal in _lenses(camera))
    rows: Rows = [
        ("image", f"{camera.width} × {camera.height} px"),
        ("view", f"{view[0]:.1f}° wide, {view[1]:.1f}° high"),
        ("position", _point(camera.X_WC.p)),
        ("looks along", f"[{', '.join(coordinate(float(v)) for v in camera.X_WC.rotation[:, 2])}]"),
        ("sees", _names([n for n, (low, high) in draft.bounds.items() if sees(camera, low, high)]) or "nothing"),
    ]
    mount = draft.spec.cameras[name].mount
    rows += [("mounted on", mount)] if mount is not None else []
    return f"{_title(name, ['camera'])}\n\n{_aligned(rows)}"


def _lenses(camera: Camera) -> tuple[tuple[int, float], tuple[int, float]]:
    return (camera.width, camera.fx), (camera.height, camera.fy)


def frame_text(name: str, X_WF: Pose) -> str:
    """Describe a named frame."""
    return f"{_title(name, ['frame'])}\n\n{_aligned(pose_rows(X_WF))}"


def file_text(reference: str, path: Path, used: Loaded | None) -> str:
    """Describe a file that a document refers to."""
    from simfoundry.assets.cache import Cache
    from simfoundry.assets.errors import MeshError
    from simfoundry.assets.mesh_summary import mesh_facts
    from simfoundry.spec.files import MESH_SUFFIXES, TEXTURE_SUFFIXES

    words, rows = ["file"], Rows()
    suffix = path.suffix.lower()
    if used is not None and used.spec is not None:
        spec = used.spec
        words = [f"{str(getattr(spec, 'simfoundry', 'document')).partition('/')[0]} `{spec.name}`"]
        for section in ("links", "joints", "objects", "robots", "cameras", "subtasks"):
            if members := getattr(spec, section, None):
                rows.append((section, _names(list(members))))
    elif suffix in MESH_SUFFIXES:
        words = ["mesh"]
        try:
            facts = mesh_facts(path, Cache.default())
        except MeshError as error:
            return f"{_title(reference, words)}\n\n{escaped(str(error))}"
        rows += [("triangles", f"{facts.triangles}"), ("size", f"{_plain(facts.sides)} in units of the file")]
        rows.append(("surface", f"open, {facts.gaps} edges have one face" if facts.gaps else "closed"))
    elif suffix in TEXTURE_SUFFIXES:
        from PIL import Image

        words = ["image"]
        try:
            with Image.open(path) as image:
                rows.append(("size", f"{image.width} × {image.height} px"))
        except Exception as error:  # Pillow raises errors of many kinds for broken images
            return f"{_title(reference, words)}\n\nThe image could not be read: {escaped(str(error))}."
    rows.append(("on disk", f"{path.stat().st_size / 1024:.1f} KiB"))
    return f"{_title(path.name, words)}\n\n{_aligned(rows)}"


# -- parts of descriptions ---------------------------------------------------------------------------------------------


def support_names(draft: DraftScene, item: SceneObject) -> list[str]:
    """Return the objects on or in which an object is placed or, if it has a pose, on which it rests."""
    place = draft.spec.objects[item.name].place
    if place is not None:
        return [place.on or place.inside or ""]
    if item.fixed:
        return []
    stated = [call.args[1] for call in map(parse_call, draft.spec.relations) if call.predicate == "OnTop"
              and call.args[0] == item.name]  # fmt: skip
    if stated or item.name not in draft.bounds:
        return stated
    low, high = draft.bounds[item.name]
    found = []
    for other in draft.solids:
        below, above = draft.bounds[other.name]
        near = bool((below <= high + HOVERING).all() and (low <= above + HOVERING).all())
        if other is not item and near and below[2] < low[2] and supports(draft, other, item):
            found.append(other.name)
    return found


def _kind_words(draft: DraftScene, item: SceneObject) -> list[str]:
    """Return what an object is, in a few words."""
    written = draft.spec.objects[item.name]
    words = [next(iter(type(written.shape).model_fields))] if written.shape is not None else []
    words += [code_span(written.asset)] if written.asset is not None else []
    words += [f"category `{item.category}`"] if item.category not in ("", item.name) else []
    words += [f"material `{written.material}`"] if written.material is not None else []
    words += [f"variant `{item.variant}`"] if item.variant else []
    return [*words, *(["fixed"] if item.fixed else [])]


def _moving(item: SceneObject) -> list[Joint]:
    return [joint for joint in item.joints if joint.type is not JointType.FIXED]


def _link_extent(link: Link) -> Array:
    spans = [geometry_bounds(piece.geometry, piece.X_LG) for piece in link.colliders or link.visuals]
    if not spans:
        return np.zeros(3)
    return np.asarray(np.max([high for _, high in spans], axis=0) - np.min([low for low, _ in spans], axis=0))


def _mass_rows(facts: MassFacts, source: str, fixed: bool) -> Rows:
    plain = source.replace("`", "")
    mass = f"{facts.mass:.4g} kg" + (f"  ({plain})" if plain else "")
    rows: Rows = [("mass", mass + (", unused: the object is fixed" if fixed else ""))]
    rows.append(("center of mass", f"{_point(facts.com)} in its frame"))
    rows.append(("inertia", f"{', '.join(f'{v:.3g}' for v in facts.moments)} kg m²"))
    return rows


def pose_rows(X_WO: Pose) -> Rows:
    """Describe a pose in the world."""
    rows: Rows = [("position", _point(X_WO.p))]
    roll, pitch, yaw = (math.degrees(float(v)) for v in rpy_from_quat(X_WO.q))
    if max(abs(roll), abs(pitch)) > 1e-3:
        rows.append(("rotation", f"roll {roll:.4g}°, pitch {pitch:.4g}°, yaw {yaw:.4g}°"))
    elif abs(yaw) > 1e-3:
        rows.append(("rotation", f"yaw {yaw:.4g}°"))
    return rows


def _joint_state(joint: Joint) -> str:
    if not joint.has_axis:
        return joint.type.value
    return f"{joint.type.value}, at {_position(joint, joint.position)}, range {_limits(joint)}"


def _position(joint: Joint, value: float) -> str:
    """Format the position of a joint [rad or m] in the units in which people think."""
    if joint.type is JointType.PRISMATIC:
        return "0 m" if value == 0 else f"{'-' * (value < 0)}{length(abs(value))}"
    return f"{math.degrees(value):.4g}° ({value:.4g} rad)" if value else "0°"


def _limits(joint: Joint) -> str:
    if joint.limits is None:
        return "unlimited"
    return " to ".join(_position(joint, value) for value in joint.limits)


def _point(p: Array) -> str:
    return f"[{', '.join(coordinate(float(v)) for v in p)}] m"


def _size(extent: Array) -> str:
    return f"{' × '.join(coordinate(100 * float(v)) for v in extent)} cm"


def _plain(values: Iterable[float]) -> str:
    return " × ".join(f"{v:.4g}" for v in values)


def _names(names: Sequence[str]) -> str:
    rest = len(names) - MOST_NAMES
    return ", ".join(names[:MOST_NAMES]) + (f" and {rest} more" if rest > 0 else "")


def _title(name: str, words: Sequence[str]) -> str:
    return " · ".join([f"**{escaped(name)}**", *words])


def _aligned(rows: Rows) -> str:
    """Return rows of a name and a text as a block in which the texts start in the same column."""
    width = max((len(name) for name, _ in rows), default=0) + 2
    return "\n".join(["```text", *(f"{name:<{width}}{text}".rstrip() for name, text in rows), "```"])
