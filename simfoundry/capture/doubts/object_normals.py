"""Measure the normals of objects, from which faults of the camera's geometry are found."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simfoundry.capture.frame import Frame
from simfoundry.capture.segment.masks import Labels, window_around
from simfoundry.capture.segment.regions import normals_of, tangents
from simfoundry.geometry.frames import Array

WIDTH = 320  # [px] width of the image in which normals are estimated, over a radius of RADIUS pixels
RADIUS = 4
TYPICAL = 0.5  # expected fraction of the pixels that are on upright sides, or on round objects
RELATED = 30  # number of pixels that are as good as one independent measurement


@dataclass(frozen=True, eq=False)
class ObjectNormals:
    """Points of objects and the normals there, in the camera frame.

    Attributes:
        points: Points [m], shape (n, 3).
        normals: Unit normals, shape (n, 3).
        labels: Number of the object at each point, shape (n,).
        columns: Column of each point in the reduced image [px], shape (n,).
        width: Width of that image [px].
        step: Factor by which that image is smaller than the original.
        focal: Horizontal focal length in that image [px].
    """

    points: Array
    normals: Array
    labels: Labels
    columns: NDArray[np.intp]
    width: int
    step: int
    focal: float


def object_normals(frame: Frame, labels: Labels) -> ObjectNormals:
    """Return the normals of the objects of an image, which is reduced to :data:`WIDTH`."""
    step = max(1, round(frame.depth.shape[1] / WIDTH))
    small = labels[::step, ::step]
    width, window = small.shape[1], window_around(small > 0, 0) if small.any() else np.s_[0:0, 0:0]
    small = small[window]
    K = np.array(frame.K, dtype=np.float64)
    K[:2] /= step
    K[:2, 2] -= window[1].start, window[0].start
    depth = np.where(small > 0, frame.depth[::step, ::step][window], np.nan)
    normals = normals_of(tangents(depth, RADIUS, 1, small), K)
    known = np.isfinite(normals[..., 2])
    points = Frame(frame.color[::step, ::step][window], depth, K).points[known]
    columns = np.nonzero(known)[1] + window[1].start
    return ObjectNormals(points, normals[known], small[known], columns, width, step, float(K[0, 0]))
