"""Meshes from images, their parts, and the joints between the parts (V_mesh, V_seg^mesh, V_articulation)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Literal, Protocol

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from simfoundry.assets.errors import MeshError
from simfoundry.assets.mesh import MeshPart, read_parts, sides
from simfoundry.assets.textures import gltf_tree
from simfoundry.models.client import Members, ModelClient
from simfoundry.models.contract import MESH, ConventionError, Member, ModelTask
from simfoundry.models.provenance import ModelIdentity
from simfoundry.models.tasks.depth import Pixels
from simfoundry.models.wire import MAX_JSON_BYTES, Bundle, BundleFile, BundleImage

# Smallest ratio of the shortest to the longest side of a generated mesh. Sheets of paper are 1:3000 and cannot be
# simulated as bodies; a mesh that is flatter is a failed generation.
FLATTEST = 3e-4

MAX_PARTS = 4096  # Segmentation models return some 100 parts

# Limits of a joint that is moved by hand: a turn and a half, beyond which an angle is in degrees [rad].
LARGEST_TURN = 3 * np.pi

Vector = tuple[float, float, float]


class MeshParameters(BaseModel):
    """The wanted mesh.

    Attributes:
        texture: Whether to generate a texture.
        faces: Number of triangles to keep.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    texture: bool = True
    faces: int = Field(20_000, ge=100, le=2_000_000)


@dataclass(frozen=True, eq=False)
class MeshEstimate:
    """A mesh as GLB: y up, in an arbitrary unit, viewed by the image from +z. ``parts`` are its geometries, z up."""

    glb: bytes
    parts: tuple[MeshPart, ...]
    made_by: ModelIdentity


class MeshModel(Protocol):
    """A mesh from images of one object (V_mesh)."""

    def make_mesh(self, image: Pixels, texture: bool = True, faces: int = 20_000, seed: int = 0) -> MeshEstimate:
        """Reconstruct the object in an RGBA image, shape (H, W, 4), whose background is transparent."""


@dataclass(frozen=True, eq=False)
class PartEstimate:
    """Labels of triangles, shape (F,): the number of the part, or -1 if it is unknown."""

    labels: NDArray[np.int32]
    made_by: ModelIdentity


class PartModel(Protocol):
    """Parts of a mesh (V_seg^mesh)."""

    def segment_mesh(self, vertices: NDArray[np.float64], faces: NDArray[np.int32], seed: int = 0) -> PartEstimate:
        """Divide a mesh into parts.

        Args:
            vertices: Positions [m], shape (V, 3), z up.
            faces: Triangles, shape (F, 3).
            seed: Seed of the model's random choices.
        """


class PredictedJoint(BaseModel):
    """A joint between two parts of a mesh, in the frame of the mesh.

    Attributes:
        part: Label of the part that moves.
        others: Labels of further parts that move with it, such as the handle of a door.
        parent: Label of the part that it is attached to, or -1 for the body, which is everything without a joint.
        type: Type of the joint.
        axis: Direction of the axis. By the right-hand rule, positive angles turn about it.
        origin: A point on the axis [m].
        lower: Lower limit from the current state [rad or m].
        upper: Upper limit from the current state [rad or m].
        name: Short name of the part, such as `door`.
        confidence: Confidence, 0 to 1.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    part: int = Field(ge=0, le=MAX_PARTS)
    others: tuple[Annotated[int, Field(ge=0, le=MAX_PARTS)], ...] = Field((), max_length=MAX_PARTS)
    parent: int = Field(-1, ge=-1, le=MAX_PARTS)
    type: Literal["revolute", "prismatic", "continuous"]
    axis: Vector
    origin: Vector = (0.0, 0.0, 0.0)
    lower: float = 0.0
    upper: float = 0.0
    name: Annotated[str, Field(max_length=64)] = ""
    confidence: float | None = Field(None, ge=0, le=1)


class JointValues(BaseModel):
    """The joints of an object; there may be none."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    joints: tuple[PredictedJoint, ...] = Field(max_length=256)


@dataclass(frozen=True, eq=False)
class ArticulationEstimate:
    """The joints between the parts of a mesh."""

    joints: tuple[PredictedJoint, ...]
    made_by: ModelIdentity


class ArticulationModel(Protocol):
    """Joints between the parts of a mesh in one state (V_articulation)."""

    def estimate_joints(
        self,
        vertices: NDArray[np.float64],
        faces: NDArray[np.int32],
        labels: NDArray[np.int32],
        views: Sequence[Pixels] = (),
    ) -> ArticulationEstimate:
        """Estimate the joints.

        Args:
            vertices: Positions [m], shape (V, 3), z up.
            faces: Triangles, shape (F, 3).
            labels: Number of the part of each triangle, shape (F,).
            views: RGB images of the object, of one size.
        """


def parse_glb(data: bytes) -> tuple[MeshPart, ...]:
    """Return the geometries of a generated GLB, z up, in the file's unit.

    Raises:
        ConventionError: If the file is no self-contained mesh with an extent in all directions.
    """
    with TemporaryDirectory(prefix="simfoundry-mesh-") as scratch:
        path = Path(scratch) / "mesh.glb"
        path.write_bytes(data)
        tree = gltf_tree(path, MAX_JSON_BYTES)
        for kind in ("buffers", "images"):
            listed = tree.get(kind, [])
            entries = listed if isinstance(listed, list) else []
            if any(isinstance(e, dict) and not str(e.get("uri", "data:")).startswith("data:") for e in entries):
                raise ConventionError("has a mesh that refers to other files; a GLB must contain its own data")
        try:
            parts = read_parts(path)
        except MeshError as error:
            raise ConventionError(f"has an unusable mesh: {error.message.replace('mesh.glb', 'it')}") from None
    extent = sides(parts)
    if not np.isfinite(extent).all() or extent.max() <= 0 or extent.min() < FLATTEST * extent.max():
        shown = " x ".join(f"{side:.3g}" for side in extent)
        raise ConventionError(f"has a mesh without an extent in all directions ({shown})")
    return parts


def _check_mesh(_: Bundle, answer: Bundle) -> None:
    blob = answer.members["mesh"]
    assert isinstance(blob, BundleFile)
    parse_glb(blob.data)


def _check_parts(_: Bundle, answer: Bundle) -> None:
    labels = answer.members["labels"]
    assert isinstance(labels, np.ndarray)
    if labels.max() < 0:
        raise ConventionError("has no labeled triangle")


def _check_joints(request: Bundle, answer: Bundle) -> None:
    labels, vertices = request.members["labels"], request.members["vertices"]
    assert isinstance(labels, np.ndarray) and isinstance(vertices, np.ndarray)
    joints = JointValues.model_validate(answer.head.get("values", {})).joints
    known = set(np.unique(labels[labels >= 0]).tolist())
    moved = Counter(label for joint in joints for label in (joint.part, *joint.others))
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    diagonal = float(np.linalg.norm(high - low))
    for joint in joints:
        who = f"has a joint of part {joint.part}"
        if joint.part not in known or (joint.parent != -1 and joint.parent not in known):
            raise ConventionError(f"{who} with the parent {joint.parent}; the parts are {sorted(known)[:20]}")
        if not known.issuperset(joint.others):
            raise ConventionError(
                f"{who} that moves with {list(joint.others[:20])}; the parts are {sorted(known)[:20]}"
            )
        twice = [label for label in (joint.part, *joint.others) if moved[label] > 1]
        if twice:
            raise ConventionError(f"has several joints of part {twice[0]}")
        length = float(np.linalg.norm(joint.axis))
        if not 0.99 < length < 1.01:
            raise ConventionError(f"{who} with an axis of length {length:.4g}; it must be a unit vector")
        if joint.type != "continuous" and joint.lower >= joint.upper:
            raise ConventionError(f"{who} whose limits {joint.lower:g} and {joint.upper:g} leave no motion")
        reach = max(abs(joint.lower), abs(joint.upper))
        if joint.type == "revolute" and reach > LARGEST_TURN:
            raise ConventionError(f"{who} that turns to {reach:.4g} rad; are the limits in degrees?")
        if joint.type == "prismatic" and reach > 2 * diagonal:
            raise ConventionError(f"{who} that slides {reach:.4g} m on an object of {diagonal:.3g} m; is it in meters?")
        off = np.maximum(np.maximum(low - joint.origin, joint.origin - high), 0)
        if joint.type != "prismatic" and float(np.linalg.norm(off)) > 0.5 * diagonal:
            raise ConventionError(f"{who} whose axis starts {np.linalg.norm(off):.3g} m away from the object")
    moving = {label: joint.part for joint in joints for label in (joint.part, *joint.others)}
    _check_tree({joint.part: moving.get(joint.parent, joint.parent) for joint in joints})


def _check_tree(parents: dict[int, int]) -> None:
    for part in parents:
        seen, at = {part}, parents[part]
        while at in parents:
            if at in seen:
                raise ConventionError(f"has joints that form a loop through part {part}")
            seen.add(at)
            at = parents[at]


VERTICES = Member("vertices", "array", "positions, z up", ("V", 3), "float64", unit="m", frame="object")
FACES = Member("faces", "array", "triangles", ("F", 3), "int32", low=0)
LABELS = Member("labels", "array", "part of each triangle, or -1", ("F",), "int32", low=-1, high=MAX_PARTS)

MESHING = ModelTask(
    "mesh", "V_mesh", "a mesh of the object in an image",
    (Member("image", "rgba", "RGBA image whose background is transparent", ("H", "W")),),
    (Member("mesh", "glb", "mesh in any unit, viewed by the image from +z", frame=MESH),),
    parameters=MeshParameters, checks=(_check_mesh,),
)  # fmt: skip

PARTS = ModelTask(
    "parts", "V_seg^mesh", "the parts of a mesh", (VERTICES, FACES),
    (LABELS,),
    checks=(_check_parts,),
)  # fmt: skip

ARTICULATE = ModelTask(
    "articulate", "V_articulation", "the joints between the parts of a mesh",
    (
        VERTICES, FACES, LABELS,
        Member("views", "images", "RGB images of the object", ("N", "H", "W"), is_optional=True),
    ),
    (), values=JointValues, checks=(_check_joints,),
)  # fmt: skip


@dataclass(frozen=True)
class BundleMeshes:
    """The tasks about meshes, solved by servers that speak ``bundle/1``."""

    client: ModelClient

    def make_mesh(self, image: Pixels, texture: bool = True, faces: int = 20_000, seed: int = 0) -> MeshEstimate:
        """Reconstruct an object; see :class:`MeshModel`."""
        wanted = MeshParameters(texture=texture, faces=faces)
        got = self.client.ask(MESHING, {"image": BundleImage(image)}, wanted, seed)
        blob = got.bundle.members["mesh"]
        assert isinstance(blob, BundleFile)
        return MeshEstimate(blob.data, parse_glb(blob.data), got.made_by)

    def segment_mesh(self, vertices: NDArray[np.float64], faces: NDArray[np.int32], seed: int = 0) -> PartEstimate:
        """Divide a mesh into parts; see :class:`PartModel`."""
        members: Members = {"vertices": vertices.astype(np.float64), "faces": faces.astype(np.int32)}
        got = self.client.ask(PARTS, members, seed=seed)
        return PartEstimate(got.array("labels"), got.made_by)

    def estimate_joints(
        self,
        vertices: NDArray[np.float64],
        faces: NDArray[np.int32],
        labels: NDArray[np.int32],
        views: Sequence[Pixels] = (),
    ) -> ArticulationEstimate:
        """Estimate the joints; see :class:`ArticulationModel`."""
        arrays: Members = {"vertices": vertices.astype(np.float64), "faces": faces.astype(np.int32)}
        pictures = tuple(map(BundleImage, views)) or None
        got = self.client.ask(ARTICULATE, {**arrays, "labels": labels.astype(np.int32), "views": pictures})
        return ArticulationEstimate(JointValues.model_validate(got.bundle.head["values"]).joints, got.made_by)
