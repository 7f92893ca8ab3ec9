"""The extent of an object about its frame, which converts an angular velocity to a speed."""

from __future__ import annotations

import numpy as np

from simfoundry.scene.model import SceneObject
from simfoundry.scene.object_shapes import bounds


def reach(item: SceneObject) -> float:
    """Return the distance [m] from an object's frame to the farthest corner of its bounding box."""
    low, high = bounds(item)
    return float(np.linalg.norm(np.maximum(np.abs(low), np.abs(high))))
