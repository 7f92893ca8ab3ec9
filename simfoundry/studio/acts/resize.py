"""Set the lengths of an object's shape."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic import ValidationError

from simfoundry.geometry.frames import Pose
from simfoundry.scene.object_shapes import world_bounds
from simfoundry.studio.acts.act import ActEdits, ActError, require_object, resolved_path
from simfoundry.studio.acts.add import lowered_object
from simfoundry.studio.acts.move import MoveObject
from simfoundry.studio.reading import StudioScene

# Names of the three lengths of a list.
_AXES = ("x", "y", "z")


def shape_lengths(shape: Mapping[str, Any]) -> dict[str, float]:
    """Return the lengths [m] of a shape, such as ``{"box": (1, 2, 3)}``, by their names; empty if it has other data."""
    key: str = next(iter(shape), "")
    value: Any = shape.get(key)
    if key == "sphere":
        return {"radius": float(value)}
    if key in ("box", "ellipsoid"):
        return dict(zip(_AXES, map(float, value), strict=True))
    if key in ("cylinder", "capsule", "cone"):
        return {name: float(value[name]) for name in ("radius", "height")}
    if key == "open_box":
        return {**dict(zip(_AXES, map(float, value["size"]), strict=True)), "wall": float(value["wall"])}
    return {}


def with_lengths(shape: Mapping[str, Any], lengths: Mapping[str, float]) -> dict[str, Any]:
    """Return a shape with all of its lengths [m] replaced, as :func:`shape_lengths` names them."""
    key = next(iter(shape))
    if key == "sphere":
        return {key: lengths["radius"]}
    axes = tuple(lengths[axis] for axis in _AXES if axis in lengths)
    if key in ("box", "ellipsoid"):
        return {key: axes}
    if key == "open_box":
        return {key: {"size": axes, "wall": lengths["wall"]}}
    return {key: dict(lengths)}


@dataclass(frozen=True)
class ResizeObject:
    """Set the lengths of an object's shape. Its lowest point stays at its height.

    Attributes:
        name: The object.
        lengths: All lengths [m] of its shape by name, such as ``{"radius": 0.03, "height": 0.1}``.
    """

    name: str
    lengths: Mapping[str, float]

    @property
    def label(self) -> str:
        """Return a short description."""
        return f"resize {self.name}"

    def edits(self, scene: StudioScene) -> ActEdits:
        """Return the edits of the shape, and of the pose if it is not that of a place."""
        require_object(scene, self.name)
        data = scene.loaded.document.data["objects"][self.name] if scene.loaded.document is not None else {}
        shape = data.get("shape", {})
        before = shape_lengths(shape) if isinstance(shape, Mapping) else {}
        if not before or before.keys() != self.lengths.keys():
            wanted = ", ".join(self.lengths) or "that can be set"
            raise ActError(f"the shape of `{self.name}` does not have the lengths {wanted}")
        values = {
            ("objects", self.name, "shape", *path): value for path, value in _changes(shape, before, self.lengths)
        }
        item = scene.objects[self.name]
        try:
            new = lowered_object(scene, self.name, {**data, "shape": with_lengths(shape, self.lengths)})
        except ValidationError:  # `check` explains better what is wrong with the lengths
            return ActEdits({resolved_path(scene.loaded.path): values})
        rise = float(world_bounds(item, item.X_WO)[0][2] - world_bounds(new, item.X_WO)[0][2])
        found: dict[Any, dict[Any, Any]] = {}
        if scene.draft.spec.objects[self.name].place is None:
            X_WO = Pose.of(item.X_WO.p + np.array([0.0, 0.0, rise]), item.X_WO.q)
            moved = MoveObject(self.name, X_WO, drop=False, carry=False).edits(scene)
            found = {path: dict(edits) for path, edits in moved.values.items()}
        found.setdefault(resolved_path(scene.loaded.path), {}).update(values)
        return ActEdits(found)


def _changes(
    shape: Mapping[str, Any], before: Mapping[str, float], after: Mapping[str, float]
) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Yield the paths and values in a shape that differ."""
    key, new = next(iter(shape)), with_lengths(shape, after)
    changed = [name for name in after if after[name] != before[name]]
    if not changed:
        return
    if key in ("sphere", "box", "ellipsoid"):
        yield (key,), new[key]
    elif key == "open_box":
        if any(name in _AXES for name in changed):
            yield (key, "size"), new[key]["size"]
        if "wall" in changed:
            yield (key, "wall"), new[key]["wall"]
    else:
        yield from (((key, name), after[name]) for name in changed)
