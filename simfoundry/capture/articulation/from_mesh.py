"""``simfoundry articulate MESH``: an asset with joints from a mesh in one state."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from simfoundry.assets.errors import MeshError
from simfoundry.assets.mesh import MeshPart, merged, read_mesh
from simfoundry.capture.articulation.actor_critic import SATISFIED, JudgedJoints, propose_joints
from simfoundry.capture.articulation.mesh_asset import LinkPhysics, PartCollision, mesh_asset
from simfoundry.capture.articulation.part_pictures import motion_picture, segment_picture
from simfoundry.capture.articulation.placed_joints import PartJoint, check_joints, parse_joint, place, predicted
from simfoundry.capture.articulation.run import picture_of
from simfoundry.capture.articulation.segments import Front, Labels, SegmentedMesh, divide, face_areas, in_object_frame
from simfoundry.errors import SimfoundryError
from simfoundry.frontends.names import plain_name
from simfoundry.models.open import open_model, open_provider
from simfoundry.models.provenance import ModelIdentity, model_use, provider_identity
from simfoundry.models.setup import ModelSetup, variable
from simfoundry.render.montage import png_bytes
from simfoundry.runtime.files import MARK, write_atomically
from simfoundry.spec.models.asset import AssetSpec
from simfoundry.spec.yaml.write import to_yaml

ASSUMED = "assumed: wood, unless a model estimated the masses; friction and damping of joints"


# Area of a triangle without any, relative to the square of the mesh's size; it is some rounding errors of its corners.
NO_AREA = 1e-12


@dataclass(frozen=True, eq=False)
class ArticulatedMesh:
    """The result for a mesh.

    Attributes:
        path: The asset document.
        picture: The picture of its parts as they move.
        joints: Its joints, in the frame of the object.
        judged: What the actor and the critic said, if joints come from a vision-language model.
        doubt: The reason to look at the picture before trusting the joints, or an empty string.
    """

    path: Path
    picture: Path
    joints: tuple[PartJoint, ...]
    judged: JudgedJoints | None
    doubt: str

    def to_json(self) -> dict[str, Any]:
        """Return the result as data for JSON."""
        joints = {
            joint.name: {
                "type": joint.type,
                "parent": joint.parent or "body",
                "axis": list(joint.axis),
                "origin": list(joint.origin),
                "range": [joint.lower, joint.upper],
                "segments": list(joint.segments),
            }
            for joint in self.joints
        }
        critiques = [] if self.judged is None else [critique.model_dump() for critique in self.judged.critiques]
        return {
            "asset": str(self.path),
            "picture": str(self.picture),
            "joints": joints,
            "critiques": critiques,
            "doubt": self.doubt,
        }

    def summary(self) -> str:
        """Return the result in a few lines."""
        lines = [f"{self.path}  {len(self.joints)} joints; see {self.picture}"]
        for joint in self.joints:
            value = f"{joint.upper:.3g} m" if joint.type == "prismatic" else f"{np.degrees(joint.upper):.3g} deg"
            lines.append(f"  {joint.name}  {joint.type}{'' if joint.type == 'continuous' else f', {value}'}")
        return "\n".join([*lines, *([f"doubtful: {self.doubt}"] if self.doubt else [])])


def articulate_mesh(
    mesh_file: Path,
    out: Path,
    setup: ModelSetup,
    joints: Sequence[str] = (),
    front: Front = "-y",
    progress: Callable[[str, float], None] | None = None,
    collision: PartCollision = "decompose",
) -> ArticulatedMesh:
    """Divide a mesh into parts, find their joints, and write it as an asset with meshes and pictures beside it.

    Args:
        mesh_file: The mesh [m], in the state in which its joints are at zero.
        out: The asset document to write.
        setup: The configured models: `parts` divides the mesh, `articulate` finds the joints.
        joints: The joints in words (:func:`simfoundry.capture.articulation.placed_joints.parse_joint`). They are used
            instead of what a model would find.
        front: The direction in which the front of the mesh faces, with z up.
        progress: A callback that receives a description and the fraction that is done.
        collision: How the parts collide: with convex parts of surfaces, or as solids where they are nearly convex.

    Raises:
        ModelError: If a model fails, or may not be used.
        SimfoundryError: If the mesh cannot be used, the joints do not fit it, or there are none and no model is
            configured; the picture of the segments is written then.
    """
    show = progress or (lambda text, share: None)
    stated = [parse_joint(text) for text in joints]
    show("dividing the mesh", 0.0)
    mesh, divider = _divided(mesh_file, setup, front)
    numbered = picture_of(out).with_suffix(".segments.png")
    write_atomically(numbered, png_bytes(segment_picture(mesh)))
    show("finding the joints", 0.2)
    makers = [("parts", divider)]
    judged = None
    if stated:
        found = [place(joint, mesh) for joint in stated]
    elif (vlm := open_provider(setup, "articulate")) is not None:
        judged = propose_joints(vlm, mesh, lambda text, share: show(text, 0.2 + 0.6 * share))
        found = list(judged.joints)
        makers.append(("articulate", provider_identity(vlm.name)))
    elif (source := setup.source("articulate")) is not None and not source.offline:
        vertices, faces = merged(mesh.pieces)
        answer = open_model(setup, "articulate").estimate_joints(vertices, faces, _numbers(mesh))
        found = predicted(answer.joints, {segment.number: segment.number for segment in mesh.segments})
        makers.append(("articulate", answer.made_by))
    else:
        raise SimfoundryError(
            f"the joints are unknown: state them by the numbers of segments in {numbered}, such as "
            "`--joint door=3,4:revolute:front_left:front:90`, or configure a model for `articulate`, such as with "
            f"{variable('articulate')}"
        )
    if not found:
        raise SimfoundryError("the model found no part that moves; state the joints with `--joint`")
    check_joints(found, mesh)
    show("writing the asset", 0.9)
    physics = {} if judged is None else judged.physics
    picture = picture_of(out)
    _write(out, picture, mesh, found, physics, makers, mesh_file, collision)
    doubt = ""
    if judged is not None and judged.rating < SATISFIED:
        doubt = f"the critic's best rating is {judged.rating} of 10: {judged.critiques[-1].suggestion}"
    return ArticulatedMesh(out, picture, tuple(found), judged, doubt)


def _divided(mesh_file: Path, setup: ModelSetup, front: Front) -> tuple[SegmentedMesh, ModelIdentity]:
    try:
        proper = [_proper(piece) for piece in read_mesh(mesh_file)]
    except MeshError as error:
        raise SimfoundryError(f"{mesh_file}: {error.message}; {error.hint}") from None
    pieces = in_object_frame([piece for piece in proper if len(piece.faces)], front)
    vertices, faces = merged(pieces)
    parts = open_model(setup, "parts").segment_mesh(vertices, faces)
    return divide(pieces, parts.labels), parts.made_by


def _proper(piece: MeshPart) -> MeshPart:
    """Return a geometry without triangles that have no area, which belong to no segment."""
    size = float(np.ptp(piece.vertices, axis=0).max())
    has_area = face_areas(piece.vertices, piece.faces) > NO_AREA * size**2
    return MeshPart(piece.vertices, piece.faces[has_area], piece.uv, piece.texture, piece.rgba)


def _numbers(mesh: SegmentedMesh) -> Labels:
    """Return the number of the segment of each triangle, or -1, in the order of ``mesh.pieces``."""
    known = [np.full(len(p.faces), segment.number) for segment in mesh.segments for p in segment.pieces]
    return np.concatenate([*known, *(np.full(len(piece.faces), -1) for piece in mesh.rest)]).astype(np.int32)


def _write(
    out: Path,
    picture: Path,
    mesh: SegmentedMesh,
    joints: Sequence[PartJoint],
    physics: dict[str, LinkPhysics],
    makers: Sequence[tuple[str, ModelIdentity]],
    mesh_file: Path,
    collision: PartCollision,
) -> None:
    origin = {
        "note": ASSUMED,
        "models": tuple(model_use(task, identity).model_dump(exclude_none=True) for task, identity in makers),
    }
    name = plain_name(out.name.split(".")[0])
    asset = mesh_asset(name, mesh, joints, physics, origin, collision)
    text = to_yaml(AssetSpec.model_validate(asset.data), comment=f"{MARK}\nfrom {mesh_file.name}")
    for relative, content in asset.files.items():
        write_atomically(out.parent / relative, content)
    write_atomically(picture, png_bytes(motion_picture(mesh, joints)))
    write_atomically(out, text.encode())
