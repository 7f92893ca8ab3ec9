"""The asset document of a mesh whose parts move, with a link and a joint for each part."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from simfoundry.assets.mass import mesh as solid_mass
from simfoundry.assets.mesh import MeshPart, merged, open_edges, weld
from simfoundry.capture.articulation.asset import DAMPING, JOINT_FRICTION, PANELS, WALL, WOOD, numbers
from simfoundry.capture.articulation.placed_joints import PartJoint
from simfoundry.capture.articulation.segments import SegmentedMesh, face_areas
from simfoundry.capture.description.mass_estimates import mass_estimate, rounded_mass
from simfoundry.geometry.frames import Array, frozen_array
from simfoundry.geometry.shapes import Mesh
from simfoundry.scene.meshfile import obj_with_material
from simfoundry.scene.model import JointType
from simfoundry.spec.models.base import Estimate

# Folder of the meshes beside an asset document.
FOLDER = "meshes"

# Smallest ratio of the shortest to the longest extent of what collides; flatter pieces, such as labels, are only seen.
FLAT = 1e-3

# Smallest mass that is assumed [kg]: that of a knob.
LIGHTEST = 0.002

BODY = "body"


# How a part collides, see `collision` of a body.
PartCollision = Literal["decompose", "auto", "none"]


@dataclass(frozen=True)
class LinkPhysics:
    """Known physical properties of a part.

    Attributes:
        mass: Its mass [kg].
        mass_source: The model that estimated the mass.
        joint_friction: Coulomb friction of its joint [N or N m].
        joint_damping: Viscous damping of its joint [N s/m or N m s/rad].
    """

    mass: float | None = None
    mass_source: str = "model"
    joint_friction: float | None = None
    joint_damping: float | None = None


@dataclass(frozen=True, eq=False)
class MeshAsset:
    """An asset document and the files that it refers to, by path relative to the document."""

    data: dict[str, Any]
    files: dict[str, bytes]


def mesh_asset(
    name: str,
    mesh: SegmentedMesh,
    joints: Sequence[PartJoint],
    physics: Mapping[str, LinkPhysics],
    origin: Mapping[str, Any],
    collision: PartCollision = "decompose",
) -> MeshAsset:
    """Return the asset of a mesh.

    Args:
        name: Name of the asset.
        mesh: The mesh in the frame of the object.
        joints: The joints of its parts; everything else is the body.
        physics: What is known of each part, by name, and of the body.
        origin: The origin to state.
        collision: How the parts collide; pictures need no colliders.
    """
    starts = link_frames(joints)
    links: dict[str, Any] = {}
    files: dict[str, bytes] = {}
    for link, own in link_pieces(mesh, joints).items():
        links[link], written = _link(joined(own), starts[link], physics.get(link, LinkPhysics()), collision)
        files |= written
    data = {
        "simfoundry": "asset/1",
        "name": name,
        "materials": {"wood": WOOD},
        "links": links,
        "joints": {
            joint.name: _joint(joint, starts[joint.parent or BODY], physics.get(joint.name, LinkPhysics()))
            for joint in joints
        },
        "origin": dict(origin),
    }
    return MeshAsset(data, files)


def link_pieces(mesh: SegmentedMesh, joints: Sequence[PartJoint]) -> dict[str, list[MeshPart]]:
    """Return the geometry of each link by name: of each part, and of the body, which is everything else."""
    moved = {number for joint in joints for number in joint.segments}
    still = [piece for segment in mesh.segments if segment.number not in moved for piece in segment.pieces]
    parts = {j.name: [piece for segment in mesh.chosen(j.segments) for piece in segment.pieces] for j in joints}
    return {BODY: [*still, *mesh.rest], **parts}


def link_frames(joints: Sequence[PartJoint]) -> dict[str, Array]:
    """Return the origin of each link's frame by name, in the frame of the object [m]; its axes are the object's."""
    return {BODY: np.zeros(3), **{joint.name: np.array(joint.origin) for joint in joints}}


def joined(pieces: Sequence[MeshPart]) -> list[MeshPart]:
    """Merge the geometries that look alike, so that a link has one for each texture or color."""
    groups: dict[tuple[bytes | None, Any, bool], list[MeshPart]] = {}
    for piece in pieces:
        groups.setdefault((piece.texture, piece.rgba, piece.uv is None), []).append(piece)
    found = []
    for (texture, rgba, is_bare), group in groups.items():
        uv = None if is_bare else np.concatenate([piece.uv for piece in group if piece.uv is not None])
        found.append(MeshPart(*merged(group), uv, texture, rgba))
    return found


def box_volume(pieces: Sequence[MeshPart]) -> float:
    """Return the volume of the box around geometries [m^3]."""
    vertices, faces = merged(pieces)
    return float(np.prod(np.ptp(vertices[np.unique(faces)], axis=0)))


def _link(
    pieces: Sequence[MeshPart], start: Array, physics: LinkPhysics, collision: str
) -> tuple[dict[str, Any], dict[str, bytes]]:
    """Return a link whose frame is at ``start``, and the files of its meshes."""
    parts: dict[str, Any] = {}
    files: dict[str, bytes] = {}
    is_closed = True
    for k, piece in enumerate(pieces):
        mesh = Mesh(frozen_array(piece.vertices), piece.faces, piece.uv, piece.texture)
        written = {f"{FOLDER}/{file}": content for file, content in obj_with_material(mesh).items()}
        files |= written
        part: dict[str, Any] = {"mesh": next(iter(written))}
        if start.any():
            part["pose"] = {"xyz": numbers(-start)}
        if piece.texture is None and piece.rgba is not None:
            part["color"] = numbers(piece.rgba[:3])
        extent = np.ptp(piece.vertices, axis=0)
        if extent.min() < FLAT * extent.max() and len(pieces) > 1:
            part["use"] = "visual"
        else:
            is_closed &= not open_edges(weld(piece.vertices, piece.faces)[1])
        parts[f"mesh_{k + 1}" if len(pieces) > 1 else "mesh"] = part
    link: dict[str, Any] = {"material": "wood", "collision": collision}
    if not is_closed:  # a part that was cut out of a surface has no volume of its own
        link["solid"] = "hull"
    mass = _assumed_mass(pieces, is_closed)
    if physics.mass is not None:
        mass = mass_estimate(physics.mass, physics.mass_source)
    link["mass"] = mass.model_dump()
    return {**link, "parts": parts}, files


def _assumed_mass(pieces: Sequence[MeshPart], is_closed: bool) -> Estimate:
    """Return an assumed mass: that of solid wood, or of panels with the area of a part that is not closed.

    Both sides of a panel may be modeled, so that its mass is that of half the area.
    """
    vertices, faces = merged(pieces)
    if is_closed:
        volume, source = abs(solid_mass(vertices, faces).volume), "assumed: solid wood"
    else:
        volume, source = 0.5 * float(face_areas(vertices, faces).sum()) * WALL, PANELS
    return mass_estimate(max(LIGHTEST, rounded_mass(volume * WOOD["density"])), source)


def _joint(joint: PartJoint, parent_start: Array, physics: LinkPhysics) -> dict[str, Any]:
    kind = JointType(joint.type)
    limits: dict[str, Any] = {}
    if kind is JointType.PRISMATIC:
        limits = {"limits": numbers((joint.lower, joint.upper))}
    elif kind is JointType.REVOLUTE:
        limits = {"limits_deg": numbers((math.degrees(joint.lower), math.degrees(joint.upper)))}
    usual = JOINT_FRICTION.get(kind, JOINT_FRICTION[JointType.REVOLUTE])
    return {
        "type": joint.type,
        "parent": joint.parent or BODY,
        "child": joint.name,
        "pose": {"xyz": numbers(np.array(joint.origin) - parent_start)},
        "axis": numbers(joint.axis),
        **limits,
        "damping": DAMPING if physics.joint_damping is None else physics.joint_damping,
        "friction": usual if physics.joint_friction is None else physics.joint_friction,
    }
