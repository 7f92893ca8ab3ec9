"""Refine the poses and sizes of reconstructed objects, in small steps and with the fit to the capture."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from simfoundry.capture.outputs.overlay import object_surface
from simfoundry.capture.shapes.evidence import Evidence
from simfoundry.capture.shapes.register_mesh import pose_agreement
from simfoundry.geometry.frames import Array, Pose
from simfoundry.scene.object_shapes import world_bounds
from simfoundry.spec.change.edit_data import DataPath
from simfoundry.spec.change.merge.conflict import ABSENT
from simfoundry.studio.acts.act import ActEdits, ActError, require_object, resolved_path
from simfoundry.studio.acts.move import MoveObject, Snap
from simfoundry.studio.reading import StudioScene

# Keys of the shapes all of whose numbers are lengths, and which are therefore scaled by one factor.
_LENGTHS = ("box", "sphere", "cylinder", "capsule", "ellipsoid", "cone", "prism", "lathe", "open_box")

# No grid and no step of angles.
NO_SNAP = Snap()

# Digits to which lengths [m] are written: 0.1 mm.
LENGTH_DIGITS = 4


@dataclass(frozen=True, eq=False)
class RefinePose:
    """Move an object to a pose that fits the capture, and note the fit.

    Attributes:
        name: The object.
        X_WO: Its new pose.
        evidence: What the capture shows of the object, or None if that is unknown.
        drop: Whether it then falls onto what is beneath.
        snap: What the pose snaps to first.
    """

    name: str
    X_WO: Pose
    evidence: Evidence | None = None
    drop: bool = False
    snap: Snap = NO_SNAP

    @property
    def label(self) -> str:
        """Return a short description."""
        return f"refine {self.name}"

    def edits(self, scene: StudioScene) -> ActEdits:
        """Return the edits of the pose, and of the fit error in `origin`, which is measured anew."""
        require_object(scene, self.name)
        if not np.isfinite(self.X_WO.p).all():
            raise ActError(f"`{self.name}` cannot be moved there, because its position would not be finite")
        move = MoveObject(self.name, self.X_WO, drop=self.drop, carry=False, snap=self.snap)
        found = move.edits(scene)
        origin = scene.spec.objects[self.name].origin
        if self.evidence is None or origin is None or origin.fit_error is None or not found.values:
            return found
        surface = object_surface(scene.objects[self.name])
        fit = pose_agreement(self.evidence, surface, move.landing(scene)[0]).fit
        values = {path: dict(edits) for path, edits in found.values.items()}
        values.setdefault(resolved_path(scene.loaded.path), {}).update(fit_edits(self.name, fit))
        return ActEdits(values, notes=found.notes)


def fit_edits(name: str, fit: float) -> dict[DataPath, Any]:
    """Return the edits that note a new fit error [m] of an object, and drop the confidence in the former fit."""
    error = round(fit, LENGTH_DIGITS) if math.isfinite(fit) else ABSENT
    return {("objects", name, "origin", "fit_error"): error, ("objects", name, "origin", "confidence"): ABSENT}


@dataclass(frozen=True)
class ScaleObject:
    """Scale an object uniformly. Its lowest point stays at its height.

    Attributes:
        name: The object.
        factor: The factor of all its lengths.
    """

    name: str
    factor: float

    @property
    def label(self) -> str:
        """Return a short description."""
        return f"scale {self.name}"

    def edits(self, scene: StudioScene) -> ActEdits:
        """Return the edits of the shape, or of the scale of a mesh, and of the pose."""
        require_object(scene, self.name)
        spec, item = scene.spec.objects[self.name], scene.objects[self.name]
        if not math.isfinite(self.factor) or self.factor <= 0:
            raise ActError("the factor must be a number greater than zero")
        written = scene.loaded.document.data["objects"][self.name] if scene.loaded.document is not None else {}
        values: dict[DataPath, Any] = {}
        if spec.shape is not None:
            shape: Mapping[str, Any] = written.get("shape", {})
            key = next(iter(shape), "")
            if key not in _LENGTHS:
                raise ActError(f"`{self.name}` is not scaled, because its shape `{key}` consists of several parts")
            values["objects", self.name, "shape"] = {key: _scaled(shape[key], self.factor)}
        elif spec.asset is not None and spec.asset.endswith(".yaml"):
            raise ActError(f"`{self.name}` is not scaled, because its asset document states its size")
        if spec.shape is None or spec.visual is not None:
            scale = written.get("scale", 1.0)
            values["objects", self.name, "scale"] = _scaled(scale, self.factor, digits=6)
        low = float(world_bounds(item, item.X_WO)[0][2])
        height = float(item.X_WO.p[2]) - low
        X_WO = Pose.of((*item.X_WO.p[:2], low + height * self.factor), item.X_WO.q)
        moved = MoveObject(self.name, X_WO, drop=False, carry=False).edits(scene)
        found = {path: dict(edits) for path, edits in moved.values.items()}
        found.setdefault(resolved_path(scene.loaded.path), {}).update(values)
        given = spec.mass is not None
        return ActEdits(found, notes=(f"The mass of {self.name} stays as it is stated",) if given else ())


def _scaled(value: Any, factor: float, digits: int = LENGTH_DIGITS) -> Any:
    """Return plain data with all its numbers multiplied by a factor and rounded."""
    if isinstance(value, Mapping):
        return {key: _scaled(each, factor, digits) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return tuple(_scaled(each, factor, digits) for each in value)
    if isinstance(value, int | float) and not isinstance(value, bool):
        return round(value * factor, digits) + 0.0
    raise ActError(f"`{value}` cannot be scaled; write a number in its place")


def nudged(X_WO: Pose, R_WA: Array, middle: Array, step: Array, turn_rad: Array) -> Pose:
    """Return a pose after a small step and a small turn along the axes of a frame A.

    Args:
        X_WO: The pose.
        R_WA: Axes of A in the world, shape (3, 3).
        middle: The point of the world [m] about which it turns, shape (3,).
        step: Translation along the axes [m], shape (3,).
        turn_rad: Rotation vector along the axes [rad], shape (3,).
    """
    angle = float(np.linalg.norm(turn_rad))
    turn = Pose.about(R_WA @ turn_rad / angle, angle) if angle > 0 else Pose.of()
    return Pose.of(middle + R_WA @ step) @ turn @ Pose.of(-middle) @ X_WO
