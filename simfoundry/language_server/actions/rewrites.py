"""Rewrite a value of a document in another form with the same meaning: rotations, masses, places and poses.

Every rewrite of a scene is lowered and compared with the scene before, so that no object moves by more than 0.1 mm.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from simfoundry.geometry.frames import Pose, quat_from_rpy, rpy_from_quat
from simfoundry.language_server.analysis import Analysis
from simfoundry.lint.draft import DraftScene, drafted
from simfoundry.spec.change.edit_text import edit_text
from simfoundry.spec.change.fixes import at, with_value
from simfoundry.spec.diagnostics import SpecError
from simfoundry.spec.load import kind_of
from simfoundry.spec.models.base import Estimate
from simfoundry.spec.models.kinds import model_of
from simfoundry.spec.models.scene import ObjectSpec, SceneSpec
from simfoundry.spec.names.positions import TextIndex
from simfoundry.spec.yaml.spelling import rounded
from simfoundry.spec.yaml.text import Document, Path_

# Largest change of a position [m] and of a rotation [rad] by a rewrite; 0.01 deg moves the rim of a 0.5 m object by
# less than 0.1 mm.
SAME_POSITION, SAME_ROTATION = 1e-4, math.radians(0.01)

# Number of objects up to which a scene is lowered again to verify a rewrite, which takes about 1 ms per object.
MOST_OBJECTS = 200

# Number of supports that are tried for an object.
MOST_SUPPORTS = 4

# Density [kg/m^3] with which the volume of an object is computed.
TRIAL_DENSITY = 1000.0


@dataclass(frozen=True)
class Rewrite:
    """A rewritten text and what was done, in the imperative."""

    title: str
    text: str


def rewrites(analysis: Analysis, path: Path_) -> Iterator[Rewrite]:
    """Yield the rewrites of the value at a path of a document's own text."""
    document = analysis.source
    if document is None or not isinstance(document.data, dict) or document.duplicates:
        return
    spec, (kind, _) = analysis.loaded.spec, kind_of(document)
    if kind is None:
        return
    model = model_of(kind)

    def edited(data: Any, old: Path_ = (), new: str = "") -> str:
        text = _renamed(document, old, new) if old else analysis.lines.text
        return edit_text(text, data, model)

    for title, data, old, new in _rotations(document.data, path):
        yield Rewrite(title, edited(data, old, new))
    if isinstance(spec, SceneSpec) and path[:1] == ("objects",) and len(path) > 1:
        work = _ObjectRewrite(analysis, spec, str(path[1]), edited)
        if work.is_plain:
            yield from work.masses()
            yield from work.places()


def _renamed(document: Document, path: Path_, new: str) -> str:
    """Return the text with another name for the key at a path, so that the new value keeps its place and comments."""
    start = TextIndex(document.text).offset(*document.place(path, of_key=True))
    old = str(path[-1])
    if not document.text.startswith(old, start):
        return document.text
    return document.text[:start] + new + document.text[start + len(old) :]


# -- rotations ------------------------------------------------------------------------------------------------------


# A rewrite of a rotation: its title, the new data, the path of the key that is renamed, and its new name.
_Rotation = tuple[str, Any, Path_, str]


def _rotations(data: Any, path: Path_) -> Iterator[_Rotation]:
    """Yield the other forms of the rotation in the mapping at a path or around it."""
    for end in range(len(path), 0, -1):
        pose = at(data, path[:end])
        if isinstance(pose, dict) and {"quat_wxyz", "rpy_deg", "yaw_deg"} & pose.keys():
            break
    else:
        return
    here = path[:end]
    if "quat_wxyz" in pose:
        if not _are_numbers(pose["quat_wxyz"]):
            return
        q = np.array(pose["quat_wxyz"], float)
        if q.shape != (4,) or not np.isfinite(q).all() or not (length := float(np.linalg.norm(q))):
            return
        if abs(length - 1) > 1e-6:  # six decimals, as in documents
            numbers = tuple(rounded(float(v)) for v in q / length)
            yield "normalize the quaternion", with_value(data, (*here, "quat_wxyz"), numbers), (), ""
        if "cameras" not in here[:1]:  # their poses have no angles
            yield from _angles(data, here, q / length)
        return
    angles = pose.get("rpy_deg") or (0.0, 0.0, pose.get("yaw_deg"))
    if "on" in pose or "inside" in pose or not _are_numbers(angles) or len(angles) != 3:
        return  # places have no quaternion
    q = quat_from_rpy(*map(math.radians, angles))
    numbers = tuple(rounded(float(v)) + 0.0 for v in q)
    yield "write the rotation as a quaternion", *_replaced(data, here, "quat_wxyz", numbers)


def _are_numbers(values: Any) -> bool:
    return isinstance(values, tuple) and all(type(v) in (int, float) and math.isfinite(v) for v in values)


def _angles(data: Any, here: Path_, q: Any) -> Iterator[_Rotation]:
    roll, pitch, yaw = (rounded(math.degrees(v)) + 0.0 for v in rpy_from_quat(q))
    new = quat_from_rpy(*map(math.radians, (roll, pitch, yaw)))
    if Pose.of(q=q).angle_to(Pose.of(q=new)) > SAME_ROTATION:
        return
    if not roll and not pitch:
        yield "write the rotation as `yaw_deg`", *_replaced(data, here, "yaw_deg", yaw)
    yield "write the rotation as `rpy_deg`", *_replaced(data, here, "rpy_deg", (roll, pitch, yaw))


def _replaced(data: Any, here: Path_, key: str, value: Any) -> tuple[Any, Path_, str]:
    """Return data in which a key replaces the rotation of a pose, the path of the old key, and the new key."""
    rotations = ("quat_wxyz", "rpy_deg", "yaw_deg")
    pose = at(data, here)
    old = next(name for name in rotations if name in pose)
    new = {(key if name == old else name): inner for name, inner in pose.items()}
    return with_value(data, here, {**new, key: value}), (*here, old), key


# -- objects of a scene -----------------------------------------------------------------------------------------------


@dataclass
class _ObjectRewrite:
    """The rewrites of one object of a scene."""

    analysis: Analysis
    spec: SceneSpec
    name: str
    edited: Callable[[Any, Path_, str], str]

    @property
    def is_plain(self) -> bool:
        """Return True if the object is written in this text, on its own, and has been lowered."""
        draft = self.analysis.draft
        own = self._own
        return (
            draft is not None
            and self.name in self.spec.objects
            and self.name in draft.scene.by_name
            and self.name not in draft.unplaced
            and len(draft.scene.objects) <= MOST_OBJECTS
            and not {"repeat", "like", "variants"} & own.keys()
            and "$" not in str(own)
        )

    @property
    def _own(self) -> dict[str, Any]:
        assert self.analysis.source is not None
        own = self.analysis.source.section("objects").get(self.name)
        return own if isinstance(own, dict) else {}

    @property
    def _draft(self) -> DraftScene:
        assert self.analysis.draft is not None
        return self.analysis.draft

    def _with(self, old: str, new: str, value: Any) -> str:
        """Return the text in which a key of the object replaces another one, if the object has it."""
        assert self.analysis.source is not None
        path = ("objects", self.name)
        kept = {key: inner for key, inner in self._own.items() if key != old}
        renamed: Path_ = (*path, old) if old in self._own else ()
        return self.edited(with_value(self.analysis.source.data, path, {**kept, new: value}), renamed, new)

    def _lowered(self, **update: Any) -> DraftScene | None:
        """Return the scene with other values of this object, or None if it cannot be lowered."""
        item = self.spec.objects[self.name]
        values = {key: getattr(item, key) for key in item.model_fields_set} | update
        new = {key: value for key, value in values.items() if value is not None}
        try:
            changed = ObjectSpec.model_validate({k: _plain(v) for k, v in new.items()})
            spec = self.spec.model_copy(update={"objects": {**self.spec.objects, self.name: changed}})
            return drafted(replace(self.analysis.loaded, spec=spec))
        except (SpecError, ValueError):
            return None

    # -- mass -------------------------------------------------------------------------------------------------------

    def masses(self) -> Iterator[Rewrite]:
        """Yield the mass instead of the density, and the density instead of the mass."""
        item = self.spec.objects[self.name]
        if isinstance(item.mass, Estimate) or isinstance(item.density, Estimate):
            return
        mass = sum(link.mass for link in self._draft.scene.by_name[self.name].links)
        if not math.isfinite(mass) or mass <= 0 or (item.asset or "").endswith(".asset.yaml"):
            return
        if item.mass is None:
            yield Rewrite(f"write the mass, {mass:.4g} kg", self._with("density", "mass", rounded(float(mass))))
        elif "mass" in self._own:
            trial = self._lowered(mass=None, density=TRIAL_DENSITY)
            whole = sum(link.mass for link in trial.scene.by_name[self.name].links) if trial is not None else 0.0
            if whole > 0:
                density = float(f"{mass / whole * TRIAL_DENSITY:.6g}")
                yield Rewrite(f"write the density, {density:.4g} kg/m^3", self._with("mass", "density", density))

    # -- places -----------------------------------------------------------------------------------------------------

    def places(self) -> Iterator[Rewrite]:
        """Yield the pose instead of the place, and a place on a support instead of the pose."""
        X_WO = self._draft.scene.by_name[self.name].X_WO
        if "place" in self._own:
            pose = _pose_data(X_WO)
            if self._is_same(self._lowered(place=None, pose=pose)):
                yield Rewrite("write the pose instead of the place", self._with("place", "pose", pose))
        elif isinstance(self._own.get("pose"), dict) and "frame" not in self._own["pose"]:
            for support in self._supports():
                place = {"on": support, **_turn(X_WO), "xy": tuple(rounded(float(v)) + 0.0 for v in X_WO.p[:2])}
                if self._is_same(self._lowered(pose=None, place=place)):
                    title = f"place it on `{support}` instead of a pose"
                    yield Rewrite(title, self._with("pose", "place", place))
                    return

    def _supports(self) -> list[str]:
        """Return the objects whose upper side may support the object, the nearest one first."""
        bounds = self._draft.bounds
        if self.name not in bounds:
            return []
        low, high = bounds[self.name]
        found = []
        for name, (other_low, other_high) in bounds.items():
            beside = (other_low[:2] > high[:2]).any() or (other_high[:2] < low[:2]).any()
            if name != self.name and not beside and other_low[2] < low[2]:
                found.append((abs(float(other_high[2] - low[2])), name))
        return [name for _, name in sorted(found)[:MOST_SUPPORTS]]

    def _is_same(self, draft: DraftScene | None) -> bool:
        """Return True if all objects are where they were."""
        if draft is None or draft.unplaced != self._draft.unplaced:
            return False
        before = self._draft.scene.by_name
        return all(
            float(np.linalg.norm(item.X_WO.p - before[name].X_WO.p)) <= SAME_POSITION
            and item.X_WO.angle_to(before[name].X_WO) <= SAME_ROTATION
            for name, item in draft.scene.by_name.items()
        )


def _plain(value: Any) -> Any:
    """Return a value of a model as plain data."""
    return value.model_dump(exclude_unset=True) if hasattr(value, "model_dump") else value


def _turn(X_WO: Pose) -> dict[str, Any]:
    """Return the rotation of a pose as the shortest key of a document, or nothing if it is not rotated."""
    roll, pitch, yaw = (rounded(math.degrees(v)) + 0.0 for v in rpy_from_quat(X_WO.q))
    if abs(roll) < math.degrees(SAME_ROTATION) / 2 and abs(pitch) < math.degrees(SAME_ROTATION) / 2:
        return {"yaw_deg": yaw} if abs(yaw) > math.degrees(SAME_ROTATION) / 2 else {}
    return {"rpy_deg": (roll, pitch, yaw)}


def _pose_data(X_WO: Pose) -> dict[str, Any]:
    """Return a pose as the data of a document, rounded to micrometers."""
    return {"xyz": tuple(rounded(float(v)) + 0.0 for v in X_WO.p), **_turn(X_WO)}
