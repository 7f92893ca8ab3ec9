"""Compare a color image with the depth: silhouettes in the depth are edges in the color image."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from simfoundry.capture.findings import OFFSET, CaptureFinding
from simfoundry.capture.frame import Frame
from simfoundry.capture.segment.masks import Labels, shrunk
from simfoundry.geometry.frames import Array

WIDTH = 640  # [px] width to which images are reduced before they are compared
SHIFTS = 24  # [px] maximum offset between color and depth that is searched
STEP = 2  # [px] step of this search; smaller offsets do no harm
MIN_SHIFT = 5  # [px] minimum offset that is reported: 1 cm at 1 m
GAIN = 1.2  # minimum ratio of the color contrast along silhouettes after and before shifting
FEWEST, FEWEST_OF_ONE = 100, 60  # [px] minimum length of all silhouettes, and of that of an object, that are compared
STEEP, EDGE_SHARE = 0.02, 0.002  # share of pixels whose slopes are equally steep, and minimum share on edges
UNIFORM = 20.0  # minimum slope on edges of a color image that is compared; noise alone stays below 10
DISTANT = 10.0  # [px] minimum shift at which silhouettes match only by chance
MATCHING = 3.5  # minimum contrast along all silhouettes; 53 of 54 tables have more, and no mirrored depth
MATCHING_ONE = 1.5  # minimum contrast along the silhouette of an object that is in the color image
UNMATCHED = (
    0.3  # maximum share of silhouettes that are not; up to 0.25 on registered tables, from 0.35 if depth is torn
)
HINT = "check `pose` and `camera` under `depth`, and the images' times"


@dataclass(frozen=True)
class ColorMatch:
    """The agreement between silhouettes in the depth and edges in the color image.

    Attributes:
        shift: Offset (columns, rows) [px] by which silhouettes match edges best.
        gain: Ratio of the color contrast there to that in place.
        contrast: Contrast in place above the mean of those at distant places, in standard deviations of these.
        unmatched: Share of the length of silhouettes that belongs to objects that are not in the color image.
    """

    shift: tuple[int, int]
    gain: float
    contrast: float
    unmatched: float


def color_doubts(frame: Frame, labels: Labels) -> Iterator[CaptureFinding]:
    """Yield a finding if silhouettes in the depth are elsewhere, or nowhere, in the color image."""
    match = color_match(frame, labels)
    if match is None:
        return
    if np.hypot(*match.shift) >= MIN_SHIFT and match.gain > GAIN:
        message = f"the color image seems to be shifted by {match.shift} px (columns, rows) against the depth image"
        yield CaptureFinding(OFFSET, message, HINT)
    elif match.contrast < MATCHING or match.unmatched > UNMATCHED:
        message = "the silhouettes of objects in the depth image are not in the color image"
        yield CaptureFinding(OFFSET, message, HINT)


def color_match(frame: Frame, labels: Labels) -> ColorMatch | None:
    """Return the agreement between color and depth, or None if silhouettes are too short or colors too uniform."""
    import cv2

    step = max(1, round(frame.depth.shape[1] / WIDTH))
    color = cv2.blur(frame.color, (step, step))[::step, ::step] if step > 1 else frame.color
    small = labels[::step, ::step]
    smooth = cv2.GaussianBlur(color, (0, 0), 1.5).astype(np.float32)
    slopes = np.hypot(cv2.Sobel(smooth, cv2.CV_32F, 1, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 1))
    slope = reduce(np.maximum, np.moveaxis(slopes, -1, 0))
    limit, edges = np.quantile(slope, [1 - STEEP, 1 - EDGE_SHARE])
    rims = [rim for k in np.unique(small[small > 0]) if len(rim := _rim(small == k))]
    lengths = np.array([len(rim) for rim in rims])
    if lengths.sum() < FEWEST or edges < UNIFORM:
        return None
    shifts = np.arange(-SHIFTS, SHIFTS + 1, STEP)
    du, dv = (grid.ravel() for grid in np.meshgrid(shifts, shifts))
    slope = np.minimum(slope, max(limit, UNIFORM))
    offsets, width = (dv * slope.shape[1] + du)[:, None], slope.shape[1]
    scores = np.array([slope.ravel()[offsets + rim[:, 0] * width + rim[:, 1]].mean(axis=1) for rim in rims])
    whole = lengths @ scores / lengths.sum()
    near, far = np.maximum(abs(du), abs(dv)) <= STEP, np.hypot(du, dv) >= DISTANT
    best = min(range(len(whole)), key=lambda k: (-whole[k], abs(du[k]) + abs(dv[k])))
    long = lengths >= FEWEST_OF_ONE
    unmatched = lengths[long & (_contrast(scores, near, far) < MATCHING_ONE)].sum() / max(1, lengths[long].sum())
    return ColorMatch(
        shift=(int(du[best]) * step, int(dv[best]) * step),
        gain=float(whole[best] / max(whole[near].max(), 1e-6)),
        contrast=float(_contrast(whole[None], near, far)[0]),
        unmatched=float(unmatched),
    )


def _rim(mask: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return the pixels (row, column) along the inside of a silhouette that stay in the image if shifted."""
    margin = SHIFTS + 1
    rim = mask & ~shrunk(mask, np.ones((3, 3), np.uint8))
    rim[:margin], rim[-margin:], rim[:, :margin], rim[:, -margin:] = False, False, False, False
    return np.argwhere(rim)


def _contrast(scores: Array, near: NDArray[np.bool_], far: NDArray[np.bool_]) -> Array:
    """Return the contrast in place of each row of scores, shape (n, shifts), in deviations of those at far shifts."""
    other = scores[:, far]
    return np.asarray((scores[:, near].max(axis=1) - other.mean(axis=1)) / np.maximum(other.std(axis=1), 1e-6))
