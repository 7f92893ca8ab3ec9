"""The surroundings of a scene as Gaussian splats, trained by a model on the image without objects."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from simfoundry.capture.frame import Frame, SupportSurface
from simfoundry.capture.model_stages.ask import Makers, ModelResult, StageModels
from simfoundry.capture.model_stages.inpaint import PROMPT
from simfoundry.capture.removal import ClearedImage, cleared_view
from simfoundry.capture.shapes.fit import FittedShape
from simfoundry.capture.stages.codec import digest_of
from simfoundry.errors import SimfoundryError
from simfoundry.geometry.frames import Array, Pose
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


# Other frames, each with the pose of its camera in that of the frame that is reconstructed.
Views = Sequence[tuple[Frame, Pose]]


def model_background(
    frame: Frame,
    support: SupportSurface,
    shapes: Mapping[int, FittedShape],
    empty: ClearedImage,
    others: Callable[[], Views],
    models: StageModels,
) -> ModelResult[bytes] | None:
    """Return the surroundings as a PLY file in the world of the scene [m], or None without a model or an answer.

    The splat is trained on images without objects and anchored twice: by the poses of the cameras, and by the support,
    whose depth in the splat gives the scale. Gaussians at the top of the support are left out, because the scene has a
    body there.

    Args:
        frame: The frame that is reconstructed.
        support: The surface that supports the objects.
        shapes: Its objects, which are removed from other frames.
        empty: The frame without objects.
        others: Loads other frames.
        models: The models.
    """
    if not models.asks("background"):
        return None
    loaded = others()
    frames = [(frame, support.X_WC), *((other, support.X_WC @ X_VF) for other, X_VF in loaded)]
    inputs = {"color": digest_of(empty.color), "depth": digest_of(empty.depth), "support": digest_of(support)}
    inputs["views"] = digest_of([value for one, X in frames for value in (one.color, one.depth, one.K, X)])
    inputs["shapes"] = digest_of(list(shapes.values())) if loaded else ""
    has_painter = models.asks("inpaint") and "inpaint" not in models.failures

    def train(setup: ModelSetup) -> tuple[bytes, Makers]:
        painter = open_model(setup, "inpaint") if has_painter else None
        images = [empty]
        for other, X_WF in frames[1:]:
            one = cleared_view(other, replace(support, X_WC=X_WF), shapes)
            color = one.color if painter is None else painter.inpaint(other.color, one.hole, PROMPT).image
            images.append(replace(one, color=color))
        X_CW = np.stack([X.inverse().matrix for _, X in frames])
        K = np.stack([each.K for each, _ in frames])
        points = np.concatenate([
            X.apply(replace(each, depth=one.depth).points[np.isfinite(one.depth)])
            for one, (each, X) in zip(images, frames, strict=True)
        ])  # fmt: skip
        depth = np.nan_to_num(np.stack([one.depth for one in images])).astype(np.float32)
        seeds = points[:: max(1, len(points) // SEEDS)]
        answer = open_model(setup, "splat").train_splat([one.color for one in images], K, X_CW, seeds, depth)
        scale = _scale(answer.ply, K[0], X_CW[0], empty.depth, support.inliers)
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
