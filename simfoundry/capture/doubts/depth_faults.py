"""Find faults of a depth image, such as noise that hides objects and edges that appear twice."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from simfoundry.capture.doubts.depth_steps import steps_doubt
from simfoundry.capture.findings import NOISY, REPEATED, CaptureFinding
from simfoundry.capture.frame import Frame, SupportSurface, depth_sigma
from simfoundry.geometry.frames import Array

WIDTH = 640  # [px] width to which larger images are reduced
SPAN = 4  # [px] distance of the readings that are compared; matching windows correlate the noise of nearer ones
NOISE = 1.15  # maximum noise, in units of the expected one; on real and simulated tables it stays below 0.95
BENT = 2.0  # maximum distance of the support's points from its plane, in the same unit; on real tables below 1.96
BLOCK = 16  # [px] size of the blocks over which the noise is averaged, on an image of WIDTH
# Maximum standard deviation of the means of blocks of the support, in units of the expected noise: on real tables at
# most 0.64, and 1.0 and more if depth grows too fast to one side, or is measured along the rays.
CURVED = 0.8
FILLED, FEWEST_BLOCKS = 0.6, 20  # minimum share of a block on the support, and minimum number of such blocks
EDGE = 0.012  # [1/m] minimum difference of inverse depths at an edge: 1 cm at 0.9 m
STEEP = 0.08  # [1/m] difference of inverse depths to which edges are limited, so that no single one dominates
NEAREST_ECHO, FARTHEST_ECHO = 6, 40  # [px] distances at which edges may repeat; sensors smear an edge over fewer
SMOOTH = 0.5  # [px] standard deviation over which slopes are averaged, so that those of staircases of pixels cancel
REPEATING = 0.14  # maximum correlation of edges with themselves at another place; it stays below 0.1 on real tables


def depth_faults(frame: Frame, support: SupportSurface) -> tuple[CaptureFinding, ...]:
    """Return a finding for each fault of a depth image that can be seen without its division into objects."""
    frame = frame.cleaned()
    return (*_noise(frame, support), *_repetition(frame.depth), *steps_doubt(frame.depth))


def _noise(frame: Frame, support: SupportSurface) -> Iterator[CaptureFinding]:
    """Yield a finding if the support is noisy or warped."""
    expected = float(np.nanmedian(depth_sigma(frame.depth[support.inliers])))
    noise = depth_noise(frame, support) / expected
    curve = support_curve(frame, support)
    bend = support.residual / (0.67 * expected)  # half of normal errors are within 0.67 standard deviations
    if noise > NOISE:
        message = f"the depth of the support is {noise:.1f} times as noisy as that of common depth cameras"
        yield CaptureFinding(NOISY, message, "average several images, or move the camera closer")
    elif bend > BENT:
        message = (
            f"the support is not flat: half of its points are more than {support.residual * 1000:.0f} mm off a plane"
        )
        yield CaptureFinding(
            NOISY, message, "check that the depth and the intrinsics are right, or flatten the support"
        )
    elif curve / expected > CURVED:
        message = f"the support seems to be warped by {curve * 1000:.1f} mm (standard deviation)"
        hint = "check that the depth is measured along the optical axis, and that the intrinsics and the lens are right"
        yield CaptureFinding(NOISY, message, hint)


def _repetition(depth: Array) -> Iterator[CaptureFinding]:
    """Yield a finding if edges appear twice."""
    shift, share = repeated_edges(depth)
    if share > REPEATING:
        message = f"edges in the depth image are smeared or appear again {shift} px (columns, rows) beside them"
        yield CaptureFinding(
            REPEATED, message, "keep camera and objects still, and check that the image is a single one"
        )


def support_curve(frame: Frame, support: SupportSurface) -> float:
    """Return the standard deviation [m] of the support's points from its plane without their noise.

    Means of blocks are compared, in which the noise cancels. Only blocks that are mostly on the support count.
    """
    step = max(1, frame.depth.shape[1] // WIDTH)
    small = Frame(frame.color[::step, ::step], frame.depth[::step, ::step], frame.K / [[step], [step], [1.0]])
    height = np.where(support.inliers[::step, ::step], support.X_WC.apply(small.points)[..., 2], np.nan)
    rows, columns = (n // BLOCK for n in height.shape)
    tiles = height[: rows * BLOCK, : columns * BLOCK].reshape(rows, BLOCK, columns, BLOCK)
    blocks = tiles.transpose(0, 2, 1, 3).reshape(-1, BLOCK * BLOCK)
    known = np.isfinite(blocks)
    full = known.mean(axis=1) > FILLED
    means = np.where(known, blocks, 0.0)[full].sum(axis=1) / known[full].sum(axis=1)
    return float(np.sqrt((means**2).mean())) if full.sum() >= FEWEST_BLOCKS else 0.0


def depth_noise(frame: Frame, support: SupportSurface) -> float:
    """Return the standard deviation [m] of the depth of the support, including coarse steps.

    Inverse depth is linear on a plane, so its second differences are zero without noise, even if the support is warped.
    A high quantile of their size is used because most differences of an image with coarse steps are zero.
    """
    step = max(1, frame.depth.shape[1] // WIDTH)
    depth = np.where(support.inliers, frame.depth, np.nan)[::step, ::step]
    sizes = []
    for z in (depth, depth.T):
        bend = 1 / z[:, 2 * SPAN :] - 2 / z[:, SPAN:-SPAN] + 1 / z[:, : -2 * SPAN]
        size = np.abs(bend) * z[:, SPAN:-SPAN] ** 2
        sizes.append(size[np.isfinite(size)])
    both = np.concatenate(sizes)
    # 90 % of normal errors are within 1.645 standard deviations; a second difference has a variance of 1 + 4 + 1.
    return float(np.quantile(both, 0.9)) / (1.645 * 6**0.5) if len(both) else 0.0


def repeated_edges(depth: Array) -> tuple[tuple[int, int], float]:
    """Return the shift (columns, rows) [px] at which edges of a depth image repeat most, and their correlation there.

    In an average of two images between which the camera moved, it is one half, whatever is in the image. Only the
    slope along the shift is compared, because a straight edge repeats along itself.
    """
    import cv2

    step = max(1, depth.shape[1] // WIDTH)
    inverse = np.nan_to_num(1 / _without_gaps(np.asarray(depth[::step, ::step], np.float64)))
    slopes = []
    for axis in (1, 0):
        slope = np.diff(inverse, axis=axis, append=0.0)
        slope[-1:], slope[:, -1:] = 0.0, 0.0
        slope = np.where(np.abs(slope) > EDGE, np.clip(slope, -STEEP, STEEP), 0.0)
        centered = (slope + np.roll(slope, 1, axis)) / 2
        slopes.append(cv2.GaussianBlur(centered, (0, 0), SMOOTH))
    h, w = (n + FARTHEST_ECHO for n in inverse.shape)  # no edge meets one at the opposite border
    x, y = np.fft.rfft2(np.stack(slopes), (h, w))
    across, down, mixed = (np.fft.irfft2(a * np.conj(b), (h, w)) for a, b in ((x, x), (y, y), (x, y)))
    far = range(-FARTHEST_ECHO, FARTHEST_ECHO + 1)
    u, v = np.meshgrid(np.array(far), np.arange(FARTHEST_ECHO + 1))
    here = across[0, 0] * u**2 + down[0, 0] * v**2 + 2 * mixed[0, 0] * u * v
    there = across[v, u] * u**2 + down[v, u] * v**2 + (mixed[v, u] + mixed[-v, -u]) * u * v
    share = np.where(np.hypot(u, v) >= NEAREST_ECHO, there / np.maximum(here, 1e-9), 0.0)
    best = np.unravel_index(int(np.argmax(share)), share.shape)
    return (int(u[best]) * step, int(v[best]) * step), float(share[best])


def _without_gaps(depth: Array) -> Array:
    """Return a depth image in which each pixel without a reading has the last one to its left, if there is one."""
    columns = np.where(np.isfinite(depth), np.arange(depth.shape[1]), 0)
    last = np.maximum.accumulate(columns, axis=1)
    return np.asarray(np.take_along_axis(depth, last, axis=1))
