"""Set the regions in which objects of a task start."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from simfoundry.spec.change.edit_data import DataPath
from simfoundry.spec.change.merge.conflict import ABSENT
from simfoundry.studio.acts.act import ActEdits, ActError, require_object, task_edits
from simfoundry.studio.reading import StudioScene

# Extent [m] of a new region: a hand's breadth to all sides of where the object is.
NEW_M = 0.2

# Decimals of the ends of a region [m]; nobody places objects by less than a millimeter.
_DIGITS = 3


@dataclass(frozen=True)
class SetRegion:
    """Let an object start anywhere in a rectangle.

    Attributes:
        name: The object.
        x: Least and greatest x in the world [m]; None stands for a region around the object.
        y: Least and greatest y in the world [m]; None stands for a region around the object.
        yaw_deg: Least and greatest rotation about z [deg], or None to leave it as it is.
    """

    name: str
    x: tuple[float, float] | None = None
    y: tuple[float, float] | None = None
    yaw_deg: tuple[float, float] | None = None

    @property
    def label(self) -> str:
        """Return a short description."""
        return f"set region of {self.name}"

    def edits(self, scene: StudioScene) -> ActEdits:
        """Return the edits of the task's reset."""
        if scene.task is None:
            return task_edits(scene, {})  # which explains that a task is needed
        require_object(scene, self.name)
        base: DataPath = ("reset", "objects", self.name)
        old = scene.task.reset.objects.get(self.name)
        p = scene.objects[self.name].X_WO.p
        edits: dict[DataPath, Any] = {}
        for axis, (key, given) in enumerate((("x", self.x), ("y", self.y))):
            if given is None and old is not None:
                continue
            low, high = sorted(given) if given is not None else (float(p[axis]) - NEW_M / 2, float(p[axis]) + NEW_M / 2)
            edits[(*base, key)] = (round(low, _DIGITS) + 0.0, round(high, _DIGITS) + 0.0)
        if self.yaw_deg is not None:
            low, high = sorted(self.yaw_deg)
            edits[(*base, "yaw_deg")] = (round(low, 1) + 0.0, round(high, 1) + 0.0) if low or high else ABSENT
        return task_edits(scene, edits)


@dataclass(frozen=True)
class RemoveRegion:
    """Let an object start where the scene or the task places it."""

    name: str

    @property
    def label(self) -> str:
        """Return a short description."""
        return f"remove region of {self.name}"

    def edits(self, scene: StudioScene) -> ActEdits:
        """Return the edit of the task's reset."""
        if scene.task is not None and self.name not in scene.task.reset.objects:
            raise ActError(f"`{self.name}` has no region")
        return task_edits(scene, {("reset", "objects", self.name): ABSENT})
