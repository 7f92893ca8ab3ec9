"""Choose among reconstructions: take objects from another version of the scene, or another shape for an object."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from simfoundry.capture.description.describe import shape_spec
from simfoundry.capture.shapes.fit import FittedShape
from simfoundry.scene.state import pose_spec
from simfoundry.spec.change.edit_data import DataPath
from simfoundry.spec.change.merge.conflict import ABSENT
from simfoundry.spec.yaml.write import to_data
from simfoundry.studio.acts.act import ActEdits, ActError, require_object, scene_edits
from simfoundry.studio.acts.refine import LENGTH_DIGITS
from simfoundry.studio.reading import StudioScene

# Keys of objects and their variants that name files relative to the document.
_FILES = ("asset", "visual")

# Digits of colors (sRGB in [0, 1]); displays show steps of 1/255.
COLOR_DIGITS = 3


@dataclass(frozen=True, eq=False)
class TakeObjects:
    """Take objects from another version of the scene.

    Attributes:
        version: The document of the version, from which the paths of its files are counted.
        data: Its composed plain data.
        names: The objects, or nothing to take all objects and the relations.
    """

    version: Path
    data: Mapping[str, Any] = field(default_factory=dict)
    names: tuple[str, ...] = ()

    @property
    def label(self) -> str:
        """Return a short description."""
        return f"take {', '.join(self.names) or 'everything'} from {self.version.name}"

    def edits(self, scene: StudioScene) -> ActEdits:
        """Return the edits of the objects, of the materials that they need, and of the relations."""
        objects = self.data.get("objects", {})
        edits: dict[DataPath, Any] = {}
        for name in self.names or tuple(objects):
            if name not in objects:
                raise ActError(f"{self.version.name} has no object `{name}`")
            entry = _relocated(objects[name], self.version.parent, scene.loaded.path.parent)
            edits["objects", name] = entry
            material = str(entry.get("material"))
            materials = self.data.get("materials", {})
            if material in materials and material not in scene.spec.materials:
                edits["materials", material] = materials[material]
        if not self.names:
            for name, item in scene.spec.objects.items():
                if name not in objects and item.origin is not None and item.origin.segment is not None:
                    edits["objects", name] = ABSENT
            edits[("relations",)] = self.data.get("relations", ABSENT)
        return scene_edits(scene, edits)


def _relocated(entry: Mapping[str, Any], old: Path, new: Path) -> dict[str, Any]:
    """Return the data of an object of another folder, with its files named from here and without its segment there."""
    out = dict(entry)
    if old != new and isinstance(out.get("origin"), Mapping):
        out["origin"] = {key: value for key, value in out["origin"].items() if key != "segment"}
    for key in _FILES:
        value = out.get(key)
        if isinstance(value, str) and ":" not in value and old != new:
            out[key] = Path(os.path.relpath(old / value, new)).as_posix()
    if isinstance(out.get("variants"), Mapping):
        out["variants"] = {name: _relocated(each, old, new) for name, each in out["variants"].items()}
    return out


@dataclass(frozen=True, eq=False)
class TakeShape:
    """Take another solid that was fitted to what the capture shows of an object.

    Attributes:
        name: The object.
        shape: The solid, at its pose in the world.
        rgb: Its color (sRGB in [0, 1]), because the texture belongs to the former solid.
    """

    name: str
    shape: FittedShape
    rgb: tuple[float, float, float]

    @property
    def label(self) -> str:
        """Return a short description."""
        return f"take another shape of {self.name}"

    def edits(self, scene: StudioScene) -> ActEdits:
        """Return the edits of the shape, the pose, the color and the fit."""
        require_object(scene, self.name)
        spec = shape_spec(self.shape)
        if spec is None:
            raise ActError(
                f"this solid of `{self.name}` is a mesh without a file; run `simfoundry capture` to write it"
            )
        path = ("objects", self.name)
        edits: dict[DataPath, Any] = {
            (*path, "shape"): to_data(spec),
            (*path, "pose"): to_data(pose_spec(self.shape.X_WO)),
            (*path, "color"): tuple(round(float(v), COLOR_DIGITS) for v in self.rgb),
            (*path, "origin", "fit_error"): round(self.shape.fit_m, LENGTH_DIGITS),
            (*path, "origin", "confidence"): round(self.shape.confidence, 2),
        }
        edits |= {(*path, key): ABSENT for key in ("asset", "visual", "scale", "place", "variant", "variants")}
        return scene_edits(scene, edits)
