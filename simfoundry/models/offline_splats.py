"""Images of splats without a model: the rasterizer of this project, on a CPU."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from simfoundry.geometry.frames import Pose
from simfoundry.models.contract import ConventionError, ModelError
from simfoundry.models.geometry_checks import Floats, check_transform
from simfoundry.models.offline import identity
from simfoundry.models.tasks.splats import SplatView, parse_splat
from simfoundry.splats.raster import splat_image


class _Lens(NamedTuple):
    """Size and intrinsics of a camera [px]."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float


class OfflineSplats:
    """Splats rendered in numpy, before black: a second for 100,000 Gaussians in an image of 320 x 240."""

    def render_splat(self, ply: bytes, K: Floats, world_to_camera: Floats, size: tuple[int, int]) -> SplatView:
        """Render a splat; see :class:`SplatRenderer`. The axes of ``K`` must be perpendicular."""
        if K.shape != (3, 3) or not np.isfinite(K).all() or K[0, 1] or min(K[0, 0], K[1, 1]) <= 0:
            raise ModelError("the intrinsic matrix of a splat's camera must have two focal lengths and no skew")
        lens = _Lens(*size, *(float(v) for v in (K[0, 0], K[1, 1], K[0, 2], K[1, 2])))
        try:
            check_transform(world_to_camera, "world_to_camera")
            splat = parse_splat(ply)
        except ConventionError as error:
            raise ModelError(f"the request {error}") from None
        seen = splat_image(splat, Pose.from_matrix(world_to_camera), lens)
        color = np.asarray(np.rint(255 * np.clip(seen.color, 0, 1)), dtype=np.uint8)
        depth, alpha = (values.astype(np.float32) for values in (seen.depth, seen.alpha))
        return SplatView(color, depth, alpha, identity("simfoundry-splats"))
