"""A capture beside the scene that was reconstructed from it: the cloud, the objects' pixels, and the fit of a pose."""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from simfoundry.capture.frame import Frame, SupportSurface
from simfoundry.capture.frames.load import load_frame
from simfoundry.capture.segment.masks import Labels
from simfoundry.capture.shapes.evidence import Evidence, gather, surface_distances
from simfoundry.capture.shapes.fit import MIN_POINTS
from simfoundry.capture.shapes.register_mesh import Surface
from simfoundry.capture.shapes.solid_casts import cast_mesh
from simfoundry.errors import SimfoundryError
from simfoundry.geometry.frames import Array, Pose
from simfoundry.geometry.shapes import tessellate
from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.model import SceneObject
from simfoundry.spec.files import Loaded
from simfoundry.spec.models.capture import Pixel

# Image of the objects' numbers, which a capture writes beside its scene: 16 bits per pixel, 0 for the background.
SEGMENTS = "segments.png"

# Angle [rad] around a click within which points are meant: about 3 pixels of a browser's window 1000 pixels high.
RAY_RAD = 0.004


@dataclass(frozen=True, eq=False)
class CaptureOverlay:
    """A frame of a capture in the world of the scene that was reconstructed from it.

    Attributes:
        frame: The image.
        X_WC: Pose of its camera in the world of the scene.
        labels: Number of the object at each pixel, shape (h, w).
    """

    frame: Frame
    X_WC: Pose
    labels: Labels

    @cached_property
    def points_W(self) -> Array:
        """The points of all pixels in the world [m], shape (h, w, 3); NaN without a reading."""
        return self.X_WC.apply(self.frame.points)

    def cloud(self, share: float = 1.0) -> tuple[Array, NDArray[np.uint8], Labels]:
        """Return the measured points.

        Args:
            share: Fraction of the points, spread evenly over the image.

        Returns:
            Points in the world [m], shape (n, 3), their colors, shape (n, 3), and their objects' numbers, shape (n,).
        """
        at = np.flatnonzero(np.isfinite(self.frame.depth))
        at = at[:: max(1, round(1 / max(share, 1e-3)))]
        return self.points_W.reshape(-1, 3)[at], self.frame.color.reshape(-1, 3)[at], self.labels.reshape(-1)[at]

    def errors(self, surfaces: Mapping[int, Surface], share: float = 1.0) -> Array:
        """Return the distances of the measured points from the surfaces of their objects.

        Args:
            surfaces: The surfaces of objects in the world, by the objects' numbers.
            share: Fraction of the points, as in :meth:`cloud`.

        Returns:
            Distances [m] as in the fit error, shape (n,): infinite for a point at which the camera would not see its
            object, and NaN for a point that belongs to none of the objects.
        """
        points, _, numbers = self.cloud(share)
        out = np.full(len(points), np.nan)
        for number, (vertices, faces) in surfaces.items():
            own = numbers == number
            if own.any() and len(faces):
                rays = points[own] - self.X_WC.p
                out[own] = surface_distances(np.ones(len(rays)), cast_mesh(self.X_WC.p, rays, vertices, faces))
        return out

    def pixel_of(self, segment: int) -> Pixel | None:
        """Return the pixel (column, row) farthest inside of an object, or None if the object has no pixels."""
        from scipy import ndimage

        mask = np.pad(self.labels == segment, 1)
        if not mask.any():
            return None
        row, column = np.unravel_index(int(np.argmax(ndimage.distance_transform_edt(mask))), mask.shape)
        return int(column) - 1, int(row) - 1

    def pixel_on_ray(self, origin: Array, direction: Array) -> Pixel | None:
        """Return the pixel (column, row) whose point is nearest along a ray in the world, or None if there is none.

        Points count if they are within :data:`RAY_RAD` of the ray, as seen from its origin.
        """
        points = self.points_W.reshape(-1, 3) - origin
        along = points @ (direction / np.linalg.norm(direction))
        beside = np.sqrt(np.maximum((points**2).sum(axis=1) - along**2, 0.0))
        near = np.flatnonzero((along > 0) & (beside < RAY_RAD * along))
        if not len(near):
            return None
        row, column = divmod(int(near[np.argmin(along[near] + beside[near] / RAY_RAD * 0.01)]), self.labels.shape[1])
        return column, row

    def evidence(self, segment: int, base_z: float) -> Evidence | None:
        """Return the evidence for an object that stands at the height ``base_z`` [m], or None for too few points."""
        mask = self.labels == segment
        if int((mask & np.isfinite(self.frame.depth)).sum()) < MIN_POINTS:
            return None
        empty = SupportSurface(self.X_WC, np.zeros((0, 2)), 0.0, np.zeros(mask.shape, dtype=bool))
        found = gather(self.frame, empty, mask, base_z, self.labels)
        return found if len(found.points) >= MIN_POINTS else None


def load_overlay(loaded: Loaded, frame_name: str, X_WC: Pose, segments: Path) -> CaptureOverlay:
    """Load a frame of a capture and the image of its objects' numbers.

    Raises:
        SpecError: The frame cannot be used. The error contains all findings.
        SimfoundryError: The image of the objects' numbers does not exist or does not belong to the frame.
    """
    frame = load_frame(loaded, frame_name).cleaned()
    return CaptureOverlay(frame, X_WC, read_segments(segments, frame.depth.shape))


def read_segments(path: Path, shape: tuple[int, ...]) -> Labels:
    """Read an image of objects' numbers.

    Raises:
        SimfoundryError: If it cannot be read, or does not have the shape (height, width) of the frame.
    """
    from PIL import Image

    try:
        with Image.open(path) as image:
            if image.size != (shape[1], shape[0]):
                size, wanted = (f"{w} x {h} pixels" for w, h in (image.size, (shape[1], shape[0])))
                message = f"{path} has {size}, but the image of the capture has {wanted}"
                raise SimfoundryError(f"{message}; run `simfoundry capture` again")
            return np.array(image).astype(np.int32).reshape(shape)
    except FileNotFoundError:
        message = f"{path} does not exist, which says where each object is in the picture"
        raise SimfoundryError(f"{message}; run `simfoundry capture` again") from None
    except (OSError, ValueError, Image.DecompressionBombError) as error:
        raise SimfoundryError(f"{path} is not an image of objects' numbers: {error}") from None


def segment_image(labels: Labels) -> bytes:
    """Return the numbers of the objects, shape (h, w), as a PNG image with 16 bits per pixel."""
    from PIL import Image

    stream = io.BytesIO()
    Image.fromarray(labels.astype(np.uint16)).save(stream, "PNG", optimize=True)
    return stream.getvalue()


def object_surface(item: SceneObject) -> Surface:
    """Return the visible surface of an object in its own frame: vertices (n, 3) [m] and faces (k, 3)."""
    X_OL, vertices, faces, count = link_poses(item), [], [], 0
    for link in item.links:
        for visual in link.visuals:
            mesh = tessellate(visual.geometry)
            vertices.append((X_OL[link.name] @ visual.X_LG).apply(mesh.vertices))
            faces.append(mesh.faces + count)
            count += len(mesh.vertices)
    if not vertices:
        return np.zeros((0, 3)), np.zeros((0, 3), np.int32)
    return np.concatenate(vertices), np.concatenate(faces).astype(np.int32)
