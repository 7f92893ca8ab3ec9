"""The splat in a scene's background, composited with images of its objects by depth.

A Gaussian hides what is behind it at each pixel, and is hidden by surfaces in front of it. Colors are blended as sRGB
values, as trainers do. Splats neither receive nor cast shadows.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from simfoundry.geometry.frames import Array, Pose
from simfoundry.scene.model import Camera, Scene
from simfoundry.splats.gaussians import GaussianSplat
from simfoundry.splats.projection import Ellipses, project
from simfoundry.splats.raster import SplatImage, composite

# Number of cameras whose splats are kept, because a static camera sees the same in each image. Each takes up to 150
# bytes for each Gaussian that it sees.
KEPT = 8

Image = NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class SplatBackdrop:
    """A splat as a camera sees it.

    Attributes:
        ellipses: The visible Gaussians.
        camera: The camera.
        image: The splat alone.
    """

    ellipses: Ellipses
    camera: Camera
    image: SplatImage

    def in_front(self, depth: Array) -> SplatImage:
        """Return the part of the splat in front of surfaces.

        Args:
            depth: Depth of the nearest opaque surface [m], or infinity where there is none, shape (h, w).
        """
        whole = self.image
        every = depth >= whole.farthest
        some = (depth > whole.nearest) & ~every  # the only pixels that depend on the exact depth
        part = composite(self.ellipses, self.camera, depth, some) if some.any() else whole
        color = np.where(every[..., None], whole.color, np.where(some[..., None], part.color, 0.0))
        alpha, half = (
            np.where(every, all_of_it, np.where(some, some_of_it, 0.0))
            for all_of_it, some_of_it in ((whole.alpha, part.alpha), (whole.depth, part.depth))
        )
        return SplatImage(color, alpha, half, whole.nearest, whole.farthest)

    def over(self, image: Image, depth: Array, coverage: Array | None = None, sky: Array | None = None) -> Image:
        """Composite the splat with an image of the objects.

        Args:
            image: sRGB image of the objects before a sky, uint8, shape (h, w, 3).
            depth: Depth of the objects [m], or infinity where there are none, shape (h, w).
            coverage: Fraction of each pixel that objects cover, shape (h, w). By default, 1 where there is a depth.
            sky: sRGB color of the sky in [0, 1], shape (3,), which is required for fractions between 0 and 1.

        Returns:
            An sRGB image, uint8, shape (h, w, 3).
        """
        seen = image / 255.0
        covered = np.isfinite(depth).astype(np.float64) if coverage is None else coverage
        share = covered[..., None]
        behind = np.where(share == 0, seen, 0.0 if sky is None else sky)
        objects = seen - (1.0 - share) * behind  # multiplied by the coverage
        front = self.in_front(depth)
        nearer = share * front.color + (1.0 - front.alpha[..., None]) * objects
        farther = self.image.color + (1.0 - self.image.alpha[..., None]) * behind
        return rounded(nearer + (1.0 - share) * farther)


def splat_backdrop(scene: Scene, camera: Camera) -> SplatBackdrop | None:
    """Return the splat of a scene's background as ``camera`` sees it, or None if the scene has none.

    The results for the last cameras are kept.
    """
    background = scene.background
    if background is None or background.splat is None:
        return None
    X_CB = camera.X_WC.inverse() @ background.X_WB
    lens = (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy)
    return _kept_backdrop(background.splat, tuple(X_CB.p.tolist()), tuple(X_CB.q.tolist()), lens)


@lru_cache(maxsize=KEPT)
def _kept_backdrop(
    splat: GaussianSplat, p: tuple[float, ...], q: tuple[float, ...], lens: tuple[int, int, float, float, float, float]
) -> SplatBackdrop:
    camera = Camera("", *lens, Pose.of())
    ellipses = project(splat, Pose.of(p, q), camera)
    return SplatBackdrop(ellipses, camera, composite(ellipses, camera))


def rounded(color: Array) -> Image:
    """Return sRGB values in [0, 1] as bytes. Values beyond are clipped."""
    return np.asarray(np.rint(255.0 * np.clip(color, 0.0, 1.0)), dtype=np.uint8)
