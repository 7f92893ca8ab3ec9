"""Methods that need no model: honest work on what is measured, with the limits that each docstring states."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from simfoundry.assets.mesh import weld
from simfoundry.models.contract import ModelError
from simfoundry.models.provenance import ModelIdentity
from simfoundry.models.tasks.depth import Depth, DepthEstimate, Floats, Mask, Pixels, StereoEstimate
from simfoundry.models.tasks.images import ImageEstimate, VideoEstimate
from simfoundry.models.tasks.masks import MaskEstimate, SegmentationPrompt, TrackEstimate, bounding_boxes
from simfoundry.models.tasks.meshes import PartEstimate

# Neighborhood that is compared in stereo matching [px]. 5 is OpenCV's advice for images of good texture.
STEREO_BLOCK = 5

# Share of an image's width that is the largest disparity. At 60° of view and 12 cm of baseline this is 0.6 m away.
STEREO_RANGE = 0.19

INPAINT_RADIUS = 3  # Neighborhood of Telea's method [px], as in OpenCV's example

GRABCUT_ROUNDS = 5  # Rounds of GrabCut, after which masks of tabletop images no longer change

# Share of a mask's color model that GrabCut sees around a point [fraction of the image's shorter side].
POINT_REACH = 0.02


def identity(method: str) -> ModelIdentity:
    """Return the identity of an offline method."""
    import cv2

    version = cv2.__version__ if method.startswith("opencv") else "1"
    return ModelIdentity(name=method, version=version, licence="Apache-2.0", commercial=True)


class OfflineDepth:
    """Stereo by semi-global matching, and holes of depth filled as continuations of the surfaces around them."""

    def match_stereo(self, left: Pixels, right: Pixels, K: Floats, baseline_m: float) -> StereoEstimate:
        """Estimate the depth of the left image; see :class:`StereoModel`.

        Surfaces without texture, glass and mirrors stay unknown. Objects nearer than about five baselines are missed.
        """
        import cv2

        width = left.shape[1]
        count = max(16, int(np.ceil(STEREO_RANGE * width / 16)) * 16)
        weight = 3 * STEREO_BLOCK**2  # 8 and 32 times the number of compared values are OpenCV's advice for P1 and P2
        matcher = cv2.StereoSGBM.create(
            0, count, STEREO_BLOCK, 8 * weight, 32 * weight, disp12MaxDiff=1, uniquenessRatio=10,
            speckleWindowSize=100, speckleRange=2, mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
        )  # fmt: skip
        # Without this border, the leftmost pixels have no disparity.
        padded = [cv2.copyMakeBorder(image, 0, 0, count, 0, cv2.BORDER_CONSTANT) for image in (left, right)]
        disparity = np.asarray(matcher.compute(*padded), np.float32)[:, count:] / 16
        u = np.arange(width)[None]
        valid = (disparity > 0.5) & (u - disparity >= 0)
        if not valid.any():
            raise ModelError("stereo matching found no depth; the images need texture, and must be rectified")
        disparity = np.asarray(np.where(valid, disparity, 0), np.float32)
        depth = np.where(valid, K[0, 0] * baseline_m / np.maximum(disparity, 1e-6), 0).astype(np.float32)
        return StereoEstimate(
            np.asarray(disparity, np.float32), np.asarray(depth, np.float32), valid, identity("opencv-sgbm")
        )

    def complete_depth(self, image: Pixels, depth: Depth, mask: Mask) -> DepthEstimate:
        """Fill the holes of a depth map; see :class:`DepthCompletionModel`. The image is not used.

        The inverse depth in a hole is the harmonic function that continues the values around it, which reproduces a
        plane exactly: the inverse depth of a plane is linear in the pixel coordinates. An object hidden by the hole is
        not recovered.
        """
        prior = np.nan_to_num(np.asarray(depth, dtype=np.float64), nan=0.0, posinf=0.0, neginf=0.0)
        hole = mask | (prior <= 0)
        if hole.all():
            raise ModelError("there is no depth from which the holes could be filled")
        inverse = _harmonic(np.where(hole, 0, 1 / np.where(hole, 1, prior)), hole)
        filled = np.where(hole, 1 / np.maximum(inverse, 1e-3), prior).astype(np.float32)
        return DepthEstimate(filled, (~hole).astype(np.float32), None, identity("harmonic-inverse-depth"))


def _harmonic(values: Floats, hole: Mask) -> Floats:
    """Return values whose Laplacian vanishes in a hole; at the edge of the image, the slope across it vanishes."""
    from scipy.sparse import coo_array
    from scipy.sparse.linalg import spsolve

    number = np.full(hole.shape, -1)
    number[hole] = np.arange(hole.sum())
    diagonal, right = np.zeros(hole.sum()), np.zeros(hole.sum())
    rows, columns = [], []
    for axis in (0, 1):
        for a, b in (((slice(1, None), slice(None, -1))), ((slice(None, -1), slice(1, None)))):
            here = (a, slice(None)) if axis == 0 else (slice(None), a)
            there = (b, slice(None)) if axis == 0 else (slice(None), b)
            inside = hole[here]
            own, other = number[here][inside], number[there][inside]
            np.add.at(diagonal, own, 1.0)
            known = other < 0
            np.add.at(right, own[known], values[there][inside][known])
            rows.append(own[~known])
            columns.append(other[~known])
    row, column = np.concatenate(rows), np.concatenate(columns)
    count = len(diagonal)
    entries = (np.concatenate([-np.ones(len(row)), diagonal]), (np.r_[row, :count], np.r_[column, :count]))
    solved = spsolve(coo_array(entries, shape=(count, count)).tocsc(), right)
    result = values.copy()
    result[hole] = solved
    return result


class OfflineMasks:
    """Masks from boxes and points by color, and their propagation by optical flow."""

    def segment(self, image: Pixels, prompt: SegmentationPrompt) -> MaskEstimate:
        """Find objects by GrabCut; see :class:`SegmentationModel`.

        Boxes and points work for objects whose colors differ from their surroundings. Phrases need a model.
        """
        import cv2

        if prompt.phrases:
            raise ModelError(
                "phrases can only be found by a model; configure one for `segment`, or use boxes or points"
            )
        seeds = [_box_seed(image, box) for box in prompt.boxes]
        seeds += [_point_seed(image, prompt.points)] if prompt.points else []
        masks, prompts = [], []
        for k, seed in enumerate(seeds):
            background, foreground = np.zeros((1, 65)), np.zeros((1, 65))
            cv2.setRNGSeed(0)
            try:
                cv2.grabCut(image, seed, None, background, foreground, GRABCUT_ROUNDS, cv2.GC_INIT_WITH_MASK)
            except cv2.error:  # one of the color models has no pixels
                continue
            mask = (seed == cv2.GC_FGD) | (seed == cv2.GC_PR_FGD)
            if mask.any():
                masks.append(mask)
                prompts.append(k if k < len(prompt.boxes) else 0)
        found = np.array(masks, bool).reshape(-1, *image.shape[:2])
        scores = np.full(len(found), 0.5, np.float32)
        return MaskEstimate(
            found, bounding_boxes(found), scores, np.array(prompts, np.int32), identity("opencv-grabcut")
        )

    def track(self, frames: Sequence[Pixels], masks: Mask, keyframe: int = 0) -> TrackEstimate:
        """Follow objects by optical flow; see :class:`TrackingModel`.

        Objects that move fast, or that are hidden for a while, are lost.
        """
        tracked = np.zeros((len(frames), *masks.shape), bool)
        tracked[keyframe] = masks
        steps = [(k, k + 1) for k in range(keyframe, len(frames) - 1)] + [(k, k - 1) for k in range(keyframe, 0, -1)]
        for old, new in steps:
            tracked[new] = _moved(frames[old], frames[new], tracked[old])
        return TrackEstimate(tracked, identity("opencv-dis-flow"))


def _box_seed(image: Pixels, box: tuple[float, float, float, float]) -> NDArray[np.uint8]:
    import cv2

    seed = np.full(image.shape[:2], cv2.GC_BGD, np.uint8)
    left, top, right, bottom = (max(0, round(value)) for value in box)
    seed[top:bottom, left:right] = cv2.GC_PR_FGD
    return seed


def _point_seed(image: Pixels, points: Sequence[tuple[float, float, int]]) -> NDArray[np.uint8]:
    import cv2

    seed = np.full(image.shape[:2], cv2.GC_PR_BGD, np.uint8)
    radius = max(1, round(POINT_REACH * min(image.shape[:2])))
    for u, v, is_on in points:
        cv2.circle(seed, (round(u), round(v)), radius, cv2.GC_FGD if is_on else cv2.GC_BGD, -1)
    return seed


def _moved(old: Pixels, new: Pixels, masks: Mask) -> Mask:
    """Return masks in the next frame: each of its pixels looks up where it came from."""
    import cv2

    gray = [cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) for image in (new, old)]
    flow = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM).calc(gray[0], gray[1], cast(Any, None))
    v, u = np.mgrid[: old.shape[0], : old.shape[1]].astype(np.float32)
    looked_up = (u + flow[..., 0], v + flow[..., 1])
    moved = [cv2.remap(mask.astype(np.float32), *looked_up, cv2.INTER_LINEAR) for mask in masks]
    return np.array(moved).reshape(masks.shape) > 0.5


class OfflineImages:
    """Holes of images filled from their surroundings."""

    def inpaint(self, image: Pixels, mask: Mask, prompt: str = "") -> ImageEstimate:
        """Fill the pixels of a mask by Telea's method; see :class:`InpaintingModel`. The prompt is not used.

        Small holes on even surfaces look right; nothing is invented behind large objects.
        """
        import cv2

        filled = cv2.inpaint(image, mask.astype(np.uint8), INPAINT_RADIUS, cv2.INPAINT_TELEA)
        return ImageEstimate(np.where(mask[..., None], filled, image).astype(np.uint8), identity("opencv-telea"))

    def inpaint_video(self, frames: Sequence[Pixels], masks: Mask, prompt: str = "") -> VideoEstimate:
        """Fill the pixels of masks, frame by frame; see :class:`VideoInpaintingModel`."""
        filled = tuple(self.inpaint(frame, mask).image for frame, mask in zip(frames, masks, strict=True))
        return VideoEstimate(filled, identity("opencv-telea"))


class OfflineMeshes:
    """Parts of a mesh that are not connected."""

    def segment_mesh(self, vertices: Floats, faces: NDArray[np.int32], seed: int = 0) -> PartEstimate:
        """Divide a mesh into its connected pieces; see :class:`PartModel`. A seamless mesh has one part."""
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components

        points, welded = weld(vertices, faces)
        if len(welded) != len(faces):
            raise ModelError("the mesh has triangles without area; remove them first")
        pairs = np.concatenate([welded[:, :2], welded[:, 1:]])
        links = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(points),) * 2)
        _, piece = connected_components(links, directed=False)
        _, labels = np.unique(piece[welded[:, 0]], return_inverse=True)
        return PartEstimate(labels.astype(np.int32), identity("connected-pieces"))
