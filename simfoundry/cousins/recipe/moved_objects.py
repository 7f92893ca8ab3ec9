"""Poses and joints of moved objects as written to documents, and the objects that are placed relative to them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from simfoundry.geometry.frames import Pose
from simfoundry.scene.model import Scene
from simfoundry.scene.state import SceneState, pose, pose_spec
from simfoundry.spec.models.scene import DEPTHS, SIDES, Place, SceneSpec

# Joint displacements [m or rad] up to this value are ignored: the joint keeps the position in its document.
STILL = 1e-3


def written(poses: Mapping[str, Pose]) -> dict[str, Pose]:
    """Round poses to the precision used in documents, which is 0.1 mm and 0.01 deg."""
    return {name: pose(pose_spec(X_WO)) for name, X_WO in poses.items()}


def dependents(spec: SceneSpec, moved: Iterable[str]) -> set[str]:
    """Return the objects whose `place` refers to an object in ``moved``.

    The reference may be direct or indirect.
    """
    places = {name: item.place for name, item in spec.objects.items() if item.place is not None}
    found, todo = set[str](), set(moved)
    while todo:
        todo = {name for name, place in places.items() if named_by(place) & todo} - found
        found |= todo
    return found


def named_by(place: Place) -> set[str]:
    """Return the names of the objects to which a `place` refers."""
    values = (getattr(place, key) for key in ("on", "inside", *SIDES, *DEPTHS))
    return {str(value).partition(".")[0] for value in values if value is not None}


def moved_joints(scene: Scene, state: SceneState, names: Iterable[str]) -> dict[str, dict[str, float]]:
    """Return the joint positions that differ from those in the scene, keyed by object and joint.

    Only joints with a single axis are included. The positions are in m or rad.
    """
    found: dict[str, dict[str, float]] = {}
    for name in names:
        for joint in scene.object(name).joints:
            at = state.joints.get(f"{name}.{joint.name}", joint.position)
            if joint.mimic is None and joint.has_axis and abs(at - joint.position) > STILL:
                low, high = joint.limits or (at, at)  # clamp to the limits, because engines may exceed them slightly
                found.setdefault(name, {})[joint.name] = round(min(max(at, low), high), 4) + 0.0
    return found
