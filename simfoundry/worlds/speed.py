"""The extent of an object about its frame, which turns a rotation into a speed."""

from __future__ import annotations

import numpy as np

from simfoundry.scene.model import SceneObject
from simfoundry.scene.object_shapes import bounds


def reach(item: SceneObject) -> float:
    """The distance [m] of the farthest corner of the box around an object from its frame."""
    low, high = bounds(item)
    return float(np.linalg.norm(np.maximum(np.abs(low), np.abs(high))))
