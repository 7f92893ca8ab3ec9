"""Align the background, a mesh or a splat, with the scene: a similarity transform of its file."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from simfoundry.geometry.frames import Pose
from simfoundry.geometry.similarity import Similarity, fit_similarity
from simfoundry.scene.state import pose
from simfoundry.spec.change.edit_data import DataPath
from simfoundry.spec.change.merge.conflict import ABSENT
from simfoundry.spec.models.surroundings import BackgroundSpec
from simfoundry.studio.acts.act import ActEdits, ActError, scene_edits
from simfoundry.studio.acts.placement import pose_data
from simfoundry.studio.reading import StudioScene

Point = tuple[float, float, float]

# Digits to which a scale is written: over a room of 10 m, the sixth one is worth 0.01 mm.
SCALE_DIGITS = 6


@dataclass(frozen=True, eq=False)
class AlignBackground:
    """Give the background a similarity transform.

    Attributes:
        S_WF: Map from the units and axes of the background's file to the world [m].
    """

    S_WF: Similarity

    @property
    def label(self) -> str:
        """Return a short description."""
        return "align the background"

    def edits(self, scene: StudioScene) -> ActEdits:
        """Return the edits of the pose and the scale of the background."""
        spec = background_spec(scene)
        scale = float(f"{self.S_WF.scale:.{SCALE_DIGITS}g}")
        if not math.isfinite(scale) or scale <= 0 or not np.isfinite(self.S_WF.X_AB.p).all():
            raise ActError("the scale of the background must be greater than zero, and its position finite")
        written = _written(scene)
        edits: dict[DataPath, Any] = {}
        data = pose_data(written.get("pose", {}), self.S_WF.X_AB, pose(spec.pose))
        edits["background", "pose"] = data or ABSENT
        if scale != float(f"{spec.scale:.{SCALE_DIGITS}g}"):
            edits["background", "scale"] = ABSENT if scale == 1.0 else scale
        return scene_edits(scene, edits)


@dataclass(frozen=True)
class AlignByPoints:
    """Align the background by pairs of points that are the same in reality.

    Attributes:
        pairs: At least three pairs, each of a point that the background shows now, and the point of the scene onto
            which it belongs. Both are in the world [m].
    """

    pairs: tuple[tuple[Point, Point], ...]

    @property
    def label(self) -> str:
        """Return a short description."""
        return f"align the background by {len(self.pairs)} points"

    def edits(self, scene: StudioScene) -> ActEdits:
        """Return the edits of the pose and the scale of the background, with the remaining error as a note."""
        S_WF = background_similarity(scene)
        now, wanted = (np.array([pair[k] for pair in self.pairs], dtype=np.float64).reshape(-1, 3) for k in (0, 1))
        try:
            S_WW = fit_similarity(now, wanted)
        except ValueError as error:
            raise ActError(f"the background cannot be aligned by these points: {error}") from None
        found = AlignBackground(S_WW @ S_WF).edits(scene)
        worst = float(S_WW.residuals(now, wanted).max())
        return ActEdits(found.values, notes=(f"The points of a pair are now at most {1000 * worst:.1f} mm apart",))


def background_spec(scene: StudioScene) -> BackgroundSpec:
    """Return the background of a scene.

    Raises:
        ActError: If the scene has none.
    """
    spec = scene.spec.background
    if spec is None:
        raise ActError("the scene has no background; add `background: {mesh: room.glb}` to the document first")
    return spec


def background_similarity(scene: StudioScene) -> Similarity:
    """Return the map from the units and axes of the background's file to the world [m].

    Raises:
        ActError: If the scene has no background.
    """
    spec = background_spec(scene)
    return Similarity(pose(spec.pose), spec.scale)


def turned_about(S_WF: Similarity, point: Point, turn: Pose, factor: float = 1.0) -> Similarity:
    """Return a similarity that is turned and scaled about a point of the world [m], and then moved.

    Args:
        S_WF: The similarity.
        point: The point of the world [m] that stays where it is, except for the translation of ``turn``.
        turn: The rotation, and the translation [m] after it, both in the world.
        factor: The factor of the scale.
    """
    p = np.array(point, dtype=np.float64)
    about = Similarity(Pose.of(p)) @ Similarity(turn, factor) @ Similarity(Pose.of(-p))
    return about @ S_WF


def _written(scene: StudioScene) -> Mapping[str, Any]:
    assert scene.loaded.document is not None
    found = scene.loaded.document.data.get("background")
    return found if isinstance(found, dict) else {}
