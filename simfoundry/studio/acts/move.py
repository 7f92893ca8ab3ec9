"""Move and turn objects: snapped to a grid and to angles, dropped onto what is beneath, with what they carry."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from simfoundry.geometry.frames import Pose, quat_from_rpy, rpy_from_quat
from simfoundry.scene.drop import DropResult
from simfoundry.scene.model import SceneObject
from simfoundry.scene.object_shapes import hulls
from simfoundry.spec.change.edit_data import DataPath
from simfoundry.studio.acts.act import ActEdits, ActError, require_object
from simfoundry.studio.acts.carry import carried_objects, rest_below
from simfoundry.studio.acts.placement import STILL_M, STILL_RAD, written_pose
from simfoundry.studio.reading import StudioScene


@dataclass(frozen=True)
class Snap:
    """Grid of positions [m] and step of angles [deg] to which a moved object snaps. Zero turns each of them off."""

    grid: float = 0.0
    angle_deg: float = 0.0

    def snapped(self, X_WO: Pose) -> Pose:
        """Return the nearest pose on the grid. The height is not changed."""
        p = X_WO.p.copy()
        if self.grid > 0:
            p[:2] = np.round(p[:2] / self.grid) * self.grid
        if self.angle_deg <= 0:
            return Pose.of(p, X_WO.q)
        step = math.radians(self.angle_deg)
        roll, pitch, yaw = (float(np.round(angle / step) * step) for angle in rpy_from_quat(X_WO.q))
        return Pose.of(p, quat_from_rpy(roll, pitch, yaw))


@dataclass(frozen=True, eq=False)
class MoveObject:
    """Move an object to a pose.

    Attributes:
        name: The object.
        X_WO: Its new pose.
        drop: Whether it then falls onto what is beneath, if it is not fixed.
        carry: Whether objects that stand on it, are inside of it or lean on it move with it.
        snap: What the pose snaps to first.
    """

    name: str
    X_WO: Pose
    drop: bool = True
    carry: bool = True
    snap: Snap = Snap()

    @property
    def label(self) -> str:
        """Return a short description."""
        return f"move {self.name}"

    def edits(self, scene: StudioScene) -> ActEdits:
        """Return the edits of the object's place or pose, and of those of the objects that it carries."""
        require_object(scene, self.name)
        if not np.isfinite(self.X_WO.p).all():
            raise ActError(f"`{self.name}` cannot be moved to a position that is not finite")
        item = scene.objects[self.name]
        riders = carried_objects(scene, self.name) if self.carry else {}
        X_WO, rest = self.landing(scene, riders)
        change = X_WO @ item.X_WO.inverse()
        placed: dict[str, SceneObject] = {**scene.objects, self.name: replace(item, X_WO=X_WO)}
        placed |= {n: replace(scene.objects[n], X_WO=change @ scene.objects[n].X_WO) for n in riders}
        values: dict[Any, dict[DataPath, Any]] = {}
        for name in (self.name, *riders):
            if name != self.name and _follows(scene, name):
                continue
            if not _is_moved(scene.objects[name].X_WO, placed[name].X_WO):
                continue
            support = rest if name == self.name else riders[name]
            found = written_pose(scene, name, placed[name].X_WO, placed, support)
            for path, edits in found.values.items():
                values.setdefault(path, {}).update(edits)
        return ActEdits(values)

    def landing(self, scene: StudioScene, riders: Collection[str] = ()) -> tuple[Pose, DropResult | None]:
        """Return the pose at which the object comes to rest, and on what, if it falls; ``riders`` move with it."""
        item, rest = scene.objects[self.name], None
        X_WO = self.snap.snapped(self.X_WO)
        if self.drop and not item.fixed and self.name in scene.draft.shapes:
            rest = rest_below(scene, hulls(item, X_WO=X_WO), {self.name, *riders})
            if rest is not None:
                X_WO = Pose.of(X_WO.p + np.array([0.0, 0.0, rest.lift]), X_WO.q)
        return X_WO, rest


def _is_moved(before: Pose, after: Pose) -> bool:
    return bool(np.abs(after.p - before.p).max() > STILL_M) or after.angle_to(before) > STILL_RAD


def _follows(scene: StudioScene, name: str) -> bool:
    """Return True if the place of an object moves it together with its support."""
    place = scene.draft.spec.objects[name].place
    if place is None:
        return scene.frames.carrier(scene.draft.spec.objects[name].pose.frame) is not None
    is_beside = any((place.left_of, place.right_of, place.in_front_of, place.behind))
    is_turned = place.yaw_deg is not None or place.rpy_deg is not None
    return place.xy is None and place.frame is None and not is_beside and not is_turned
