"""Gaussian splats of a static scene: training from images with poses, and rendering."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from simfoundry.assets.errors import MeshError
from simfoundry.models.client import ModelClient
from simfoundry.models.contract import CAMERA, ConventionError, Member, ModelError, ModelTask
from simfoundry.models.geometry_checks import Floats, check_depth_unit, check_transform
from simfoundry.models.provenance import ModelIdentity
from simfoundry.models.tasks.depth import Depth, Pixels
from simfoundry.models.wire import Bundle, BundleFile, BundleImage
from simfoundry.splats.files import read_splat
from simfoundry.splats.gaussians import GaussianSplat

# Fraction of the Gaussians that must lie within ten times the extent of the cameras and seed points. Trainers leave a
# few far floaters; a splat in another unit or frame lies elsewhere altogether.
INSIDE = 0.5


@dataclass(frozen=True, eq=False)
class SplatEstimate:
    """A splat in the frame of the given poses, as a PLY file and as values."""

    ply: bytes
    gaussians: GaussianSplat
    made_by: ModelIdentity


@dataclass(frozen=True, eq=False)
class SplatView:
    """A rendered splat: RGB (H, W, 3), depth [m] (H, W) with 0 where nothing is, and opacity 0 to 1 (H, W)."""

    image: Pixels
    depth: Depth
    alpha: Depth
    made_by: ModelIdentity


class SplatModel(Protocol):
    """Trains a splat."""

    def train_splat(
        self, images: Sequence[Pixels], K: Floats, world_to_camera: Floats, points: Floats, depth: Depth | None = None
    ) -> SplatEstimate:
        """Train a splat.

        Args:
            images: RGB images of one shape (H, W, 3).
            K: Intrinsic matrices [px], shape (N, 3, 3).
            world_to_camera: Poses, shape (N, 4, 4) [m].
            points: Points to start from [m], shape (P, 3).
            depth: Depth of the images [m], shape (N, H, W), 0 where unknown.
        """


class SplatRenderer(Protocol):
    """Renders a splat."""

    def render_splat(self, ply: bytes, K: Floats, world_to_camera: Floats, size: tuple[int, int]) -> SplatView:
        """Render a splat from a camera. ``size`` is the width and height [px]."""


def parse_splat(data: bytes) -> GaussianSplat:
    """Return the Gaussians of a PLY file.

    Raises:
        ConventionError: If the file is not a usable splat.
    """
    with TemporaryDirectory(prefix="simfoundry-splat-") as scratch:
        path = Path(scratch) / "splat.ply"
        path.write_bytes(data)
        try:
            return read_splat(path)
        except MeshError as error:
            raise ConventionError(f"has an unusable splat: {error.message}") from None


def _check_splat(request: Bundle, answer: Bundle) -> None:
    blob, poses, points = answer.members["splat"], request.members["world_to_camera"], request.members["points"]
    assert isinstance(blob, BundleFile) and isinstance(poses, np.ndarray) and isinstance(points, np.ndarray)
    positions = parse_splat(blob.data).positions
    known = np.concatenate([np.linalg.inv(poses)[:, :3, 3], points])
    center, reach = known.mean(axis=0), float(np.linalg.norm(np.ptp(known, axis=0)))
    inside = (np.linalg.norm(positions - center, axis=1) < 10 * reach).mean()
    if inside < INSIDE:
        raise ConventionError(f"has a splat of which {1 - inside:.0%} lies far from all cameras and seed points")


def _check_view(request: Bundle, answer: Bundle) -> None:
    depth, alpha, pose = answer.members["depth"], answer.members["alpha"], request.members["world_to_camera"]
    assert isinstance(depth, np.ndarray) and isinstance(alpha, np.ndarray) and isinstance(pose, np.ndarray)
    check_transform(pose, "world_to_camera")
    if (depth > 0).any() or (depth < 0).any():
        check_depth_unit(depth)
    if ((alpha > 0.5) & (depth == 0)).any():
        raise ConventionError("has opaque pixels without depth")


POSES = Member("world_to_camera", "array", "poses", ("N", 4, 4), "float64", unit="m", frame=CAMERA)

SPLAT = ModelTask(
    "splat", "splat trainer", "a Gaussian splat from images with poses",
    (
        Member("images", "images", "RGB images of one size", ("N", "H", "W")),
        Member("K", "array", "intrinsic matrices", ("N", 3, 3), "float64", unit="px"), POSES,
        Member("points", "array", "points to start from", ("P", 3), "float64", unit="m"),
        Member("depth", "array", "depth of the images", ("N", "H", "W"), unit="m", frame=CAMERA, is_optional=True),
    ),
    (Member("splat", "ply", "splat in the frame of the poses"),), checks=(_check_splat,),
)  # fmt: skip

SPLAT_IMAGE = ModelTask(
    "splat_image", "splat renderer", "a Gaussian splat seen by a camera",
    (
        Member("splat", "ply", "splat"), Member("K", "array", "intrinsic matrix", (3, 3), "float64", unit="px"),
        Member("world_to_camera", "array", "pose", (4, 4), "float64", unit="m", frame=CAMERA),
        Member("blank", "image", "black image of the wanted size", ("H", "W")),
    ),
    (
        Member("image", "image", "RGB image", ("H", "W")),
        Member("depth", "array", "depth, 0 where nothing is", ("H", "W"), unit="m", frame=CAMERA),
        Member("alpha", "array", "opacity", ("H", "W"), low=0, high=1),
    ),
    checks=(_check_view,),
)  # fmt: skip


@dataclass(frozen=True)
class BundleSplats:
    """The tasks about splats, solved by servers that speak ``bundle/1``."""

    client: ModelClient

    def train_splat(
        self, images: Sequence[Pixels], K: Floats, world_to_camera: Floats, points: Floats, depth: Depth | None = None
    ) -> SplatEstimate:
        """Train a splat; see :class:`SplatModel`."""
        numbers: dict[str, NDArray[np.float64]] = {"K": K, "world_to_camera": world_to_camera, "points": points}
        arrays = {name: np.asarray(values, dtype=np.float64) for name, values in numbers.items()}
        prior = None if depth is None else np.asarray(depth, dtype=np.float32)
        got = self.client.ask(SPLAT, {"images": tuple(map(BundleImage, images)), **arrays, "depth": prior})
        blob = got.bundle.members["splat"]
        assert isinstance(blob, BundleFile)
        return SplatEstimate(blob.data, parse_splat(blob.data), got.made_by)

    def render_splat(self, ply: bytes, K: Floats, world_to_camera: Floats, size: tuple[int, int]) -> SplatView:
        """Render a splat; see :class:`SplatRenderer`."""
        if not ply.startswith(b"ply"):
            raise ModelError("a splat to render must be a PLY file")
        numbers = {"K": K, "world_to_camera": world_to_camera}
        arrays = {name: np.asarray(values, dtype=np.float64) for name, values in numbers.items()}
        blank = BundleImage(np.zeros((size[1], size[0], 3), np.uint8))
        got = self.client.ask(SPLAT_IMAGE, {"splat": BundleFile("ply", ply), **arrays, "blank": blank})
        image = got.bundle.members["image"]
        assert isinstance(image, BundleImage)
        return SplatView(image.pixels, got.array("depth"), got.array("alpha"), got.made_by)
