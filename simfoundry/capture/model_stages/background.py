"""The surroundings of a scene as Gaussian splats, trained by a model on the image without objects."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from simfoundry.capture.frame import Frame, SupportSurface
from simfoundry.capture.model_stages.ask import Makers, ModelResult, StageModels
from simfoundry.capture.removal import ClearedImage
from simfoundry.capture.stages.codec import digest_of
from simfoundry.errors import SimfoundryError
from simfoundry.geometry.frames import Array
from simfoundry.models.offline_splats import OfflineSplats
from simfoundry.models.open import open_model
from simfoundry.models.setup import ModelSetup
from simfoundry.splats.alignment import bridge_cameras, scale_from_depth
from simfoundry.splats.files import splat_bytes
from simfoundry.splats.gaussians import GaussianSplat

# File of the background beside the scene.
BACKGROUND = "background.ply"

# Number of points from which a training starts.
SEEDS = 20_000

# Size [px] of the view in which the depth of a splat is compared, wide enough for some thousand pixels of the support.
WIDTH = 240

# Largest factor by which a splat may be off in size. The poses are in meters, so more is an error of the model.
SCALE_OFF = 1.25

# Distance [m] from the top of the support within which Gaussians show what the support of the scene shows.
SKIN = 0.015


def model_background(
    frame: Frame, support: SupportSurface, empty: ClearedImage, models: StageModels
) -> ModelResult[bytes] | None:
    """Return the surroundings as a PLY file in the world of the scene [m], or None without a model or an answer.

    The splat is trained on the image without objects and anchored twice: by the pose of the camera, and by the
    support, whose depth in the splat gives the scale. Gaussians at the top of the support are left out, because the
    scene has a body there.
    """
    inputs = {"color": digest_of(empty.color), "depth": digest_of(empty.depth), "K": digest_of(frame.K)}
    inputs |= {"X_WC": digest_of(support.X_WC), "outline": digest_of(support.outline)}

    def train(setup: ModelSetup) -> tuple[bytes, Makers]:
        X_CW = support.X_WC.inverse().matrix
        known = np.isfinite(empty.depth)
        points = support.X_WC.apply(Frame(empty.color, empty.depth, frame.K).points[known])
        seeds = points[:: max(1, len(points) // SEEDS)]
        depth = np.nan_to_num(empty.depth).astype(np.float32)[None]
        answer = open_model(setup, "splat").train_splat([empty.color], frame.K[None], X_CW[None], seeds, depth)
        scale = _scale(answer.ply, frame.K, X_CW, empty.depth, support.inliers)
        bridge = bridge_cameras([support.X_WC], [support.X_WC], scale)
        placed = answer.gaussians.moved(bridge.S_WF)
        beside = placed.selected(~_on_support(placed, support))
        if not len(beside):
            raise SimfoundryError("the splat shows nothing but the support")
        return splat_bytes(beside, Path(BACKGROUND).name), {"splat": answer.made_by}

    return models.ask("background", inputs, train)


def _scale(ply: bytes, K: Array, X_CW: Array, depth: Array, on_support: np.ndarray) -> float:
    """Return the length of one unit of a splat [m], by the depth of the support."""
    step = max(1, depth.shape[1] // WIDTH)
    small = np.diag([1 / step, 1 / step, 1.0]) @ K
    measured = np.where(on_support, depth, np.nan)[step // 2 :: step, step // 2 :: step]
    seen = OfflineSplats().render_splat(ply, small, X_CW, (measured.shape[1], measured.shape[0]))
    scale = scale_from_depth(seen.depth.astype(np.float64), measured)
    if not 1 / SCALE_OFF < scale < SCALE_OFF:
        raise SimfoundryError(f"the splat is {1 / scale:.2g} times as large as the support that it shows")
    return scale


def _on_support(splat: GaussianSplat, support: SupportSurface) -> np.ndarray:
    import shapely

    x, y, z = splat.positions.astype(np.float64).T
    return np.asarray((np.abs(z) < SKIN) & shapely.contains_xy(shapely.Polygon(support.outline), x, y))
