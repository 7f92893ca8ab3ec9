"""Find straight seams in an image: lines of pixels at which one part of an image ends and another one begins.

A reader that loses the start of a row rolls the image, so that its borders meet inside it. Memory that is copied while
it is written contains two images. Edges of real objects are rarely as straight, as sharp and as long as such a seam.
Objects that were moved in the image also lean, because each pixel looks in another direction, and stop leaning if the
image is rolled back.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simfoundry.capture.doubts.intrinsics import focal_fit
from simfoundry.capture.doubts.object_normals import RELATED, TYPICAL, ObjectNormals
from simfoundry.capture.findings import PARTS, CaptureFinding
from simfoundry.capture.frame import Frame, SupportSurface
from simfoundry.capture.segment.masks import Labels
from simfoundry.geometry.frames import Array

LENGTH = 640  # [px] number of rows or columns that are compared along a seam; others of a larger image are left out
COLOR_JUMP = 8.0  # minimum step of the color at a seam, in excess of the steps beside it
NOISES = 3.0  # the same, in standard deviations of the noise
DEPTH_JUMP = 0.03  # [1/m] minimum step of the inverse depth, in excess of the steps beside it: 2.4 cm at 0.9 m
MARGIN = 4  # [px] distance from the border of the image within which resampling and undistortion leave lines
# Minimum share of an image's height along which a column is a seam: by itself, on real tables at most 0.28; where the
# borders of the image continue each other; and where objects are upright as well if the image is rolled back.
WHOLE, ROLLED, FAINT = 0.5, 0.15, 0.05
CONTINUED = 0.25  # maximum share that differs between continuing borders, relative to that at the seam; above 2.6
UPRIGHT = 0.044  # standard deviation of the cosine between the support's normal and that of an upright side: 2.5 deg
PLACES = 16  # number of equally spaced columns at which a rolled image may begin
CERTAIN = 30.0  # minimum gain of rolling an image back that is reported: at most 20 on real tables, 40 to 115 on rolled
SUPPORTING = 5.0  # minimum gain that confirms a faint seam
HINT = "check what reads and stores the images: a row may have lost its start, or two images may have been mixed"


@dataclass(frozen=True)
class Seam:
    """The most distinct straight line across an image.

    Attributes:
        place: Column or row [px] that begins behind the line.
        share: Share of the image's height or width along which color or depth jumps there.
        wrapped: The same share between the last column or row and the first one, as if the image were rolled up.
    """

    place: int
    share: float
    wrapped: float

    def rolled(self, least: float) -> bool:
        """Return True if the borders of the image continue each other, and it is interrupted at the seam."""
        return self.share > least and self.wrapped < CONTINUED * self.share


def seam_doubts(frame: Frame, support: SupportSurface, labels: Labels, seen: ObjectNormals) -> Iterator[CaptureFinding]:
    """Yield a finding if an image is rolled, or consists of two parts."""
    (edge, upright), (_, level) = seams(frame, labels, axis=1), seams(frame, labels, axis=0)
    up = support.X_WC.rotation[2]
    place, gain = _likely_start(seen, up)
    at_seam = roll_gain(seen, up, upright.place)
    # In a rolled image, the sides of objects lean.
    if upright.rolled(ROLLED if at_seam < SUPPORTING else FAINT) and at_seam > -SUPPORTING:
        message = f"the image seems to be rolled: its left and right borders meet at column {upright.place}"
    elif level.rolled(ROLLED):
        message = f"the image seems to be rolled: its upper and lower borders meet at row {level.place}"
    # Another focal length makes objects lean as well, and is reported as such.
    elif gain > CERTAIN and gain > focal_fit(support, seen).gain:
        message = f"the sides of objects lean, as if the image were rolled and its borders met near column {place}"
    # The edge of a table may be as level as a row, but the edges of upright things lean beside the middle of an image.
    elif edge.share > WHOLE:
        message = f"the image seems to consist of two parts that meet at column {edge.place}"
    else:
        return
    yield CaptureFinding(PARTS, message, HINT)


def _likely_start(seen: ObjectNormals, up: Array) -> tuple[int, float]:
    """Return the column [px] at which an image begins if it is rolled, and the gain of rolling it back.

    The gain is 0 if the first or last place is best, where a wrong principal point has the same effect.
    """
    places = [seen.step * seen.width * k // PLACES for k in range(1, PLACES)]
    gains = [roll_gain(seen, up, place) for place in places]
    best = int(np.argmax(gains))
    return places[best], gains[best] if 0 < best < len(places) - 1 else 0.0


def roll_gain(seen: ObjectNormals, up: Array, place: int) -> float:
    """Return the logarithm of the likelihood ratio between an image that begins at a column and one that does not.

    Shifting a pixel shears what it shows along the viewing direction.

    Args:
        seen: Normals of the objects.
        up: Normal of the support in the camera frame, shape (3,).
        place: Column of the original image [px].
    """
    place //= seen.step
    shift = np.where(seen.columns < place, seen.width - place, -place) / seen.focal
    return float((_upright(seen.normals, up, shift) - _upright(seen.normals, up, np.zeros_like(shift))).sum()) / RELATED


def _upright(normals: Array, up: Array, shift: Array) -> Array:
    """Return the log-density of normals, shape (n, 3), if each pixel is shifted, shape (n,), in focal lengths."""
    z, up_z = normals[:, 2] - shift * normals[:, 0], up[2] - shift * up[0]
    lengths = np.sqrt((1 - normals[:, 2] ** 2 + z**2) * (1 - up[2] ** 2 + up_z**2))
    cosine = (normals[:, :2] @ up[:2] + z * up_z) / lengths
    normal = np.exp(-0.5 * (cosine / UPRIGHT) ** 2) / (UPRIGHT * math.sqrt(2 * math.pi))
    return np.asarray(np.log(TYPICAL * normal + (1 - TYPICAL) / 2))


def seams(frame: Frame, labels: Labels, axis: int) -> tuple[Seam, Seam]:
    """Return the most distinct seams between columns (``axis`` 1) or rows (``axis`` 0).

    The first one counts all places along a line, the second one only those that are not the outline of an object: the
    edge of a box on an even table looks like a seam.
    """
    color, depth = np.asarray(frame.color, np.float32), frame.depth
    if axis == 0:
        color, depth, labels = color.transpose(1, 0, 2), depth.T, labels.T
    step = max(1, len(depth) // LENGTH)
    steps = reduce(np.maximum, np.moveaxis(np.abs(_step(color[::step])), -1, 0))  # max() takes five times as long
    noise = float(np.median(steps)) / 0.67  # half of normal errors are within 0.67 standard deviations
    jumps = steps - _beside(steps) > max(COLOR_JUMP, NOISES * noise)
    rises = np.abs(_step(1 / depth[::step]))
    jumps |= rises - _beside(rises) > DEPTH_JUMP
    within = labels[::step] == np.roll(labels[::step], 1, axis=1)
    return _most_distinct(jumps), _most_distinct(jumps & within)


def _most_distinct(jumps: NDArray[np.bool_]) -> Seam:
    """Return the seam at the column that most jumps precede, of those of shape (rows, columns)."""
    share = jumps.mean(axis=0)
    inner = share[MARGIN:-MARGIN]
    place = int(np.argmax(inner)) + MARGIN if len(inner) else 0
    return Seam(place, float(share[place]), float(share[0]))


def _step(values: NDArray[np.floating[Any]]) -> NDArray[np.floating[Any]]:
    """Return the difference between each column and the one before it; the first one follows the last one."""
    return np.asarray(values - np.roll(values, 1, axis=1))


def _beside(steps: NDArray[np.floating[Any]]) -> NDArray[np.floating[Any]]:
    """Return the larger one of the steps on either side of each column; unknown ones count only if both are."""
    return np.asarray(np.fmax(np.roll(steps, 1, axis=1), np.roll(steps, -1, axis=1)))
