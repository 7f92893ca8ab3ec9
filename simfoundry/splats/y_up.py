"""Axes of formats whose y axis points up (glTF, SPZ), and the z-up axes of this project."""

from __future__ import annotations

import math

from simfoundry.geometry.frames import Pose
from simfoundry.geometry.similarity import Similarity
from simfoundry.splats.gaussians import GaussianSplat

# Rotation from axes with y up and z backward to axes with z up and y forward: a quarter turn about x.
X_ZY = Pose.of(q=(math.sqrt(0.5), math.sqrt(0.5), 0.0, 0.0))


def turned_z_up(splat: GaussianSplat) -> GaussianSplat:
    """Return a splat that has y up with z up."""
    return splat.moved(Similarity(X_ZY))


def turned_y_up(splat: GaussianSplat) -> GaussianSplat:
    """Return a splat that has z up with y up."""
    return splat.moved(Similarity(X_ZY.inverse()))
