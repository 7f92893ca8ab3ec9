"""Shapes that models suggest for objects, beside those that were fitted."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from simfoundry.capture.shapes.fit import FittedShape
from simfoundry.geometry.frames import Pose


@dataclass(frozen=True, eq=False)
class ShapeChoice:
    """A model's shape or pose for an object beside the fitted one.

    Attributes:
        shape: The shape of the model, at the pose that fits the image best.
        cost: Its cost, which decides.
        fitted_cost: The cost of the shape before.
        is_better: True if the model's shape is used.
    """

    shape: FittedShape
    cost: float
    fitted_cost: float
    is_better: bool


@dataclass(frozen=True, eq=False)
class JointedObject:
    """An object with joints.

    Attributes:
        files: The asset document, its meshes and its picture, by path relative to the scene.
        asset: Path of the document.
        X_MA: Pose of the frame of the asset in that of the mesh.
        joints: Names of its joints.
    """

    files: Mapping[str, bytes]
    asset: str
    X_MA: Pose
    joints: tuple[str, ...]
