"""Segments of a mesh: those of a segmentation model, or its pieces that are not connected."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from simfoundry.assets.mesh import MeshPart, adjacent_faces, merged
from simfoundry.errors import SimfoundryError
from simfoundry.geometry.frames import Array, Pose, quat_from_matrix
from simfoundry.geometry.ray_casts import area_normals

Labels = NDArray[np.int32]

# Largest number of segments that people and models can tell apart in pictures. Smaller ones join the body.
MOST = 60

# The direction in which the front of a mesh faces. GLB files of generated meshes are viewed from their +z, which is -y
# once z is up.
Front = Literal["-y", "+y", "+x", "-x"]

# Turns about z, in quarters, that bring a front to +x.
_QUARTERS: dict[Front, int] = {"+x": 0, "-y": 1, "-x": 2, "+y": 3}


@dataclass(frozen=True, eq=False)
class Segment:
    """Triangles that belong together.

    Attributes:
        number: Its number, from 1, as it is shown in pictures.
        pieces: Its geometry, in the frame of the object [m].
        low: Lowest coordinates [m], shape (3,).
        high: Highest coordinates [m], shape (3,).
        area: Area of its triangles [m^2].
    """

    number: int
    pieces: tuple[MeshPart, ...]
    low: Array
    high: Array
    area: float


@dataclass(frozen=True, eq=False)
class SegmentedMesh:
    """A mesh in the frame A of its object: x out of its front, z up, origin below its center, divided into segments.

    The largest segments come first. ``rest`` has the triangles of all others, which are part of the body.
    """

    segments: tuple[Segment, ...]
    rest: tuple[MeshPart, ...]

    @property
    def pieces(self) -> tuple[MeshPart, ...]:
        """The geometries of all segments, one segment after another, and then the rest."""
        return (*(piece for segment in self.segments for piece in segment.pieces), *self.rest)

    @property
    def bounds(self) -> tuple[Array, Array]:
        """The lowest and the highest coordinates of the mesh [m], of shape (3,) each."""
        return bounds(self.pieces)

    def chosen(self, numbers: Sequence[int]) -> tuple[Segment, ...]:
        """Return segments by number.

        Raises:
            SimfoundryError: If there is no segment with one of the numbers.
        """
        known = {segment.number: segment for segment in self.segments}
        missing = [number for number in numbers if number not in known]
        if missing:
            raise SimfoundryError(
                f"there is no segment {', '.join(map(str, missing))}; segments are numbered from 1 to {len(known)}"
            )
        return tuple(known[number] for number in numbers)


def face_areas(vertices: Array, faces: NDArray[np.int32]) -> Array:
    """Return the areas of triangles [m^2], shape (F,)."""
    return np.asarray(np.linalg.norm(area_normals(vertices[faces]), axis=1) / 2)


def bounds(pieces: Sequence[MeshPart]) -> tuple[Array, Array]:
    """Return the lowest and the highest coordinates of geometries [m], of shape (3,) each."""
    points = np.concatenate([piece.vertices[np.unique(piece.faces)] for piece in pieces])
    return points.min(axis=0), points.max(axis=0)


def in_object_frame(pieces: Sequence[MeshPart], front: Front) -> tuple[MeshPart, ...]:
    """Return the geometries of a mesh in the frame of its object.

    Args:
        pieces: The geometries [m], z up.
        front: The direction in which the front faces.
    """
    X_AM = object_frame(pieces, front).inverse()
    return tuple(MeshPart(X_AM.apply(p.vertices), p.faces, p.uv, p.texture, p.rgba) for p in pieces)


def object_frame(pieces: Sequence[MeshPart], front: Front) -> Pose:
    """Return the pose of the object's frame A in that of its mesh; see :func:`in_object_frame`."""
    quarters = _QUARTERS[front]
    c, s = (1, 0, -1, 0)[quarters], (0, 1, 0, -1)[quarters]
    R_MA = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]], dtype=np.float64)
    low, high = bounds(pieces)
    return Pose.of(np.array([*(low + high)[:2] / 2, low[2]]), quat_from_matrix(R_MA))


def divide(pieces: Sequence[MeshPart], labels: Labels) -> SegmentedMesh:
    """Divide a mesh into segments.

    Args:
        pieces: The geometries of the mesh, in the frame of the object [m].
        labels: The label of each triangle of all geometries, one geometry after another, shape (F,). Triangles with the
            label -1 get that of most of their neighbors, and so on (paper, section "Articulated Object Generation").
    """
    vertices, faces = merged(pieces)
    labels = spread_labels(vertices, faces, labels)
    areas = face_areas(vertices, faces)
    sizes = {int(label): float(areas[labels == label].sum()) for label in np.unique(labels[labels >= 0])}
    order = sorted(sizes, key=lambda label: (-sizes[label], label))[:MOST]
    segments = []
    for number, label in enumerate(order, 1):
        own = _cut(pieces, labels == label)
        segments.append(Segment(number, own, *bounds(own), sizes[label]))
    return SegmentedMesh(tuple(segments), _cut(pieces, ~np.isin(labels, order)))


def spread_labels(vertices: Array, faces: NDArray[np.int32], labels: Labels) -> Labels:
    """Return labels in which triangles with the label -1 have that of most of their labeled neighbors, if there is one.

    Args:
        vertices: Vertices of the mesh, shape (V, 3).
        faces: Triangles, shape (F, 3).
        labels: Label of each triangle, shape (F,).
    """
    found = labels.astype(np.int32)
    pairs = adjacent_faces(vertices, faces)
    both = np.concatenate([pairs, pairs[:, ::-1]])
    while (found < 0).any():
        asking = both[(found[both[:, 0]] < 0) & (found[both[:, 1]] >= 0)]
        if not len(asking):
            break
        votes, counts = np.unique(np.column_stack([asking[:, 0], found[asking[:, 1]]]), axis=0, return_counts=True)
        ranked = votes[np.lexsort((votes[:, 1], -counts, votes[:, 0]))]
        first = np.unique(ranked[:, 0], return_index=True)[1]
        found[ranked[first, 0]] = ranked[first, 1]
    return found


def _cut(pieces: Sequence[MeshPart], wanted: NDArray[np.bool_]) -> tuple[MeshPart, ...]:
    """Return the wanted triangles of each geometry, of which at least one is wanted."""
    found, start = [], 0
    for piece in pieces:
        mine = wanted[start : start + len(piece.faces)]
        start += len(piece.faces)
        if not mine.any():
            continue
        used, faces = np.unique(piece.faces[mine], return_inverse=True)
        uv = None if piece.uv is None else piece.uv[used]
        corners = faces.reshape(-1, 3).astype(np.int32)
        found.append(MeshPart(piece.vertices[used], corners, uv, piece.texture, piece.rgba))
    return tuple(found)
