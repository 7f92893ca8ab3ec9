"""Write a new pose of an object as the document wrote its old one: a place stays a place where it still says it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from simfoundry.geometry.frames import Array, Pose
from simfoundry.scene.carriers import Carrier, PlaceError
from simfoundry.scene.drop import DropResult
from simfoundry.scene.model import SceneObject
from simfoundry.scene.place import RELATIONS, approach, solve
from simfoundry.scene.state import pose_spec
from simfoundry.spec.change.edit_data import DataPath
from simfoundry.spec.change.merge.conflict import ABSENT
from simfoundry.spec.models.scene import Place
from simfoundry.spec.yaml.write import to_data
from simfoundry.studio.acts.act import ActEdits, resolved_path
from simfoundry.studio.reading import StudioScene

# Largest deviation of a place from the wanted position [m] and rotation [rad]. Positions are written to 0.1 mm and
# angles to 0.01 deg, and a support's surface may be approximated by less than a millimeter.
POSITION_ERROR, ROTATION_ERROR = 1e-3, 2e-3

# Movement [m] and rotation [rad] below which something counts as unmoved: half of what is written.
STILL_M, STILL_RAD = 5e-5, 1e-4

# Decimals of positions that are written [m], which is 0.1 mm.
DIGITS = 4


@dataclass(frozen=True)
class PoseSource:
    """Place in a document that states the pose of an object.

    Attributes:
        is_task: True for the start of a task, and False for the scene.
        key: ``place`` or ``pose``.
        data: The plain data of the place or pose.
    """

    is_task: bool
    key: str
    data: Mapping[str, Any]

    def path(self, key: str, name: str) -> DataPath:
        """Return the path at which the document states a place or pose of an object."""
        return ("start", key, name) if self.is_task else ("objects", name, key)

    def edits(self, scene: StudioScene, name: str, key: str, data: Mapping[str, Any]) -> ActEdits:
        """Return the edits that replace the pose or place."""
        values: dict[DataPath, Any] = {self.path(key, name): dict(data) if data else ABSENT}
        if key != self.key:
            values[self.path(self.key, name)] = ABSENT
        loaded = scene.root if self.is_task else scene.loaded
        return ActEdits({resolved_path(loaded.path): values})


def pose_source(scene: StudioScene, name: str) -> PoseSource:
    """Return where the documents state the pose of an object: in the start of the task, or in the scene."""
    if scene.task is not None:
        for key in ("place", "pose"):
            if name in getattr(scene.task.start, key):
                return PoseSource(True, key, _data(scene.root, ("start", key, name)))
    key = "place" if scene.spec.objects[name].place is not None else "pose"
    return PoseSource(False, key, _data(scene.loaded, ("objects", name, key)))


def _data(loaded: Any, path: DataPath) -> Mapping[str, Any]:
    value: Any = loaded.document.data
    for part in path:
        value = value.get(part, {}) if isinstance(value, dict) else {}
    return value if isinstance(value, dict) else {}


def written_pose(
    scene: StudioScene, name: str, X_WO: Pose, placed: Mapping[str, SceneObject], drop: DropResult | None
) -> ActEdits:
    """Return the edits that give an object a pose.

    Args:
        scene: The scene.
        name: The object.
        X_WO: Its new pose.
        placed: All objects at their new poses, but this one at any.
        drop: What it rests on at this pose, or None if it does not rest on anything.
    """
    source = pose_source(scene, name)
    if source.key == "place":
        for data in _places(scene, name, source.data, X_WO, placed, drop):
            if _says(scene, name, data, X_WO, placed):
                return source.edits(scene, name, "place", data)
        return source.edits(scene, name, "pose", to_data(pose_spec(X_WO)))
    frame = source.data.get("frame")
    X_FO = scene.frames.pose(frame, placed).inverse() @ X_WO
    X_FO_before = scene.frames.pose(frame, scene.objects).inverse() @ scene.objects[name].X_WO
    data = pose_data(source.data, X_FO, X_FO_before)
    return source.edits(scene, name, "pose", data)


def pose_data(written: Mapping[str, Any], X_FO: Pose, X_FO_before: Pose) -> dict[str, Any]:
    """Return the plain data of a pose, with its keys and its unchanged coordinates as they were written.

    Args:
        written: The data of the pose before.
        X_FO: The new pose in the frame that the data names.
        X_FO_before: The pose before, which ``written`` states.
    """
    data = {**written, "xyz": moved(written.get("xyz", (0.0, 0.0, 0.0)), X_FO.p)}
    if X_FO.angle_to(X_FO_before) > STILL_RAD:
        data = {key: value for key, value in data.items() if key not in ("yaw_deg", "rpy_deg", "quat_wxyz")}
        if "quat_wxyz" in written:
            data["quat_wxyz"] = tuple(round(float(v), 6) + 0.0 for v in X_FO.q)
        else:
            data |= {k: v for k, v in to_data(pose_spec(X_FO)).items() if k != "xyz"}
    if not any(data["xyz"]) and "xyz" not in written:
        del data["xyz"]
    return data


def moved(before: Any, after: Array) -> tuple[float, ...]:
    """Return rounded coordinates [m], in which those that did not move stay as they were written."""
    old = before if isinstance(before, tuple) and len(before) == len(after) else (None,) * len(after)
    return tuple(
        was if isinstance(was, int | float) and abs(was - now) < STILL_M else round(now, DIGITS) + 0.0
        for was, now in zip(old, after.tolist(), strict=True)
    )


def _says(
    scene: StudioScene, name: str, data: Mapping[str, Any], X_WO: Pose, placed: Mapping[str, SceneObject]
) -> bool:
    """Return True if a place has the pose as its solution."""
    try:
        found = solve(scene.objects[name], Place(**data), placed, scene.scene.viewer, scene.frames)
    except (PlaceError, ValueError):
        return False
    return bool(np.linalg.norm(found.p - X_WO.p) < POSITION_ERROR) and found.angle_to(X_WO) < ROTATION_ERROR


def _places(
    scene: StudioScene,
    name: str,
    old: Mapping[str, Any],
    X_WO: Pose,
    placed: Mapping[str, SceneObject],
    drop: DropResult | None,
) -> Iterator[dict[str, Any]]:
    """Yield places that may have the pose as their solution, those most like the old one first."""
    supports = list(_supports(old, placed, drop))
    for key, support in supports:
        kept = old.get(key) == support
        base = {k: v for k, v in old.items() if k not in ("on", "inside")} | {key: support}
        base = _turned(scene, base, X_WO, placed)
        if kept:
            yield base
            yield from _beside(scene, name, base, X_WO, placed)
            if "local_xy" in base:
                try:
                    X_CO = Carrier.of(support, placed).X_WC.inverse() @ X_WO
                    yield {**base, "local_xy": moved(base["local_xy"], X_CO.p[:2])}
                except PlaceError:
                    continue
        plain = {k: v for k, v in base.items() if k not in (*RELATIONS, "gap", "offset", "local_xy", "seen_from")}
        p = (scene.frames.pose(base.get("frame"), placed).inverse() @ X_WO).p[:2]
        yield {**plain, "xy": moved(base.get("xy"), p)}


def _supports(
    old: Mapping[str, Any], placed: Mapping[str, SceneObject], drop: DropResult | None
) -> Iterator[tuple[str, str]]:
    """Yield the keys and names of supports: that of the old place, then the object below, its links and its parts."""
    for key in ("on", "inside"):
        if key in old and (drop is None or old[key].partition(".")[0] == drop.support):
            yield key, old[key]
    if drop is None:
        return
    item = placed[drop.support]
    pieces = [(link, piece) for link in item.links for piece in (link.colliders or link.visuals)]
    link, piece = pieces[drop.part] if drop.part < len(pieces) else (item.root, None)
    names = [item.name, f"{item.name}.{link.name}"] if len(item.links) > 1 else [item.name]
    names += [f"{item.name}.{piece.name}"] if piece is not None and len(pieces) > 1 else []
    yield from ((key, name) for name in names for key in ("inside", "on"))


def _turned(scene: StudioScene, place: dict[str, Any], X_WO: Pose, placed: Mapping[str, SceneObject]) -> dict[str, Any]:
    """Return a place with the rotation of a pose, written as before if the rotation is the same."""
    X_FO = scene.frames.pose(place.get("frame"), placed).inverse() @ X_WO
    written = to_data(pose_spec(X_FO))
    keys = {k: v for k, v in written.items() if k in ("yaw_deg", "rpy_deg")}
    if keys == {k: v for k, v in place.items() if k in ("yaw_deg", "rpy_deg")}:
        return place
    return {k: v for k, v in place.items() if k not in ("yaw_deg", "rpy_deg")} | keys


def _beside(
    scene: StudioScene, name: str, place: dict[str, Any], X_WO: Pose, placed: Mapping[str, SceneObject]
) -> Iterator[dict[str, Any]]:
    """Yield a place that keeps its relation to other objects, with a new gap or a new offset.

    A relation is kept only while the object stays on the stated side.
    """
    stated = [word for word in RELATIONS if word in place]
    if not stated:
        return
    plain = {key: value for key, value in place.items() if key != "offset"}
    try:
        spec = Place(**plain)
        _, _, xy = approach(scene.objects[name], spec, placed, scene.scene.viewer, scene.frames)
        X_WF = scene.frames.pose(spec.frame, placed)
        viewer = scene.scene.viewer
        if spec.seen_from is not None:
            viewer = scene.frames.viewer(spec.seen_from, placed)
    except (PlaceError, ValueError):
        return
    away = np.array([1.0, 0.0]) if viewer is None else viewer.rotation[:2, 0] / np.linalg.norm(viewer.rotation[:2, 0])
    axes = (away, np.array([-away[1], away[0]]))
    shift = X_WO.p[:2] - xy
    along = {word: RELATIONS[word][1] * float(axes[RELATIONS[word][0]] @ shift) for word in stated}
    gaps = {word: spec.gap + value for word, value in along.items()}
    if min(gaps.values()) < 0:
        return
    (word,) = stated if len(stated) == 1 else (None,)
    if word is not None and abs(float(axes[1 - RELATIONS[word][0]] @ shift)) < STILL_M:
        yield {**plain, "gap": round(gaps[word], 4) + 0.0}
    offset = X_WF.rotation[:2, :2].T @ shift
    yield {**plain, "offset": moved(place.get("offset"), offset)}
