"""Several joints of one MJCF body as the axes of one joint."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydantic_core import PydanticCustomError

from simfoundry.geometry.frames import Array
from simfoundry.spec.models.joint import AxisSpec, check_axes

# Largest distance [m] between the anchors of hinges that intersect; files state the same numbers for them.
SAME_POINT = 1e-9


def common_anchor(mujoco: Any, model: Any, joints: list[int]) -> Array | None:
    """Return the point of a body in which the axes of its joints intersect, or None if they cannot be one joint."""
    hinges = [j for j in joints if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_HINGE]
    slides = [j for j in joints if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_SLIDE]
    points = [np.array(model.jnt_pos[j]) for j in hinges or slides[:1]]
    is_shifted = any(model.qpos0[model.jnt_qposadr[j]] for j in joints[1:])  # with `ref`, zero is another pose
    if len(hinges) + len(slides) < len(joints) or is_shifted or np.ptp(points, axis=0).max() > SAME_POINT:
        return None
    sliding = {str(j): AxisSpec.model_construct(type="prismatic", axis=tuple(model.jnt_axis[j])) for j in slides}
    turning = {str(j): AxisSpec.model_construct(type="continuous", axis=tuple(model.jnt_axis[j])) for j in hinges}
    try:
        check_axes(sliding | turning)
    except PydanticCustomError:
        return None
    return points[0]
