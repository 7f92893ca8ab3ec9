"""Add objects from shapes and assets, on a free place."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from pydantic import ValidationError

from simfoundry.assets.cache import Cache
from simfoundry.geometry.frames import Array, Pose
from simfoundry.scene.model import SceneObject
from simfoundry.scene.object_shapes import hulls
from simfoundry.scene.objects import ObjectLowering
from simfoundry.spec.files import FileError, is_document
from simfoundry.spec.load import load
from simfoundry.spec.models.scene import ObjectSpec
from simfoundry.studio.acts.act import ActEdits, ActError, require_new_name, require_object, scene_edits
from simfoundry.studio.acts.placement import DIGITS
from simfoundry.studio.reading import StudioScene

# Space [m] that is left around a new object, and the steps [m] in which a free place is sought.
FREE_M, STEP_M = 0.02, 0.05

# Number of rings of places around the middle of a support that are tried: 60 cm to each side.
RINGS = 12

# Mass [kg] of a new object for which nothing else is stated: that of a mug that is easy to lift for every gripper.
NEW_MASS = 0.2


@dataclass(frozen=True)
class AddObject:
    """Add an object on a free place.

    Attributes:
        name: The name of the new object.
        fields: Its plain fields, such as ``{"shape": {"sphere": 0.03}}`` or ``{"asset": "mug.asset.yaml"}``.
        support: The object to put it on; by default, the largest fixed one.
        xy: Where to put it [m]; by default, the free place that is nearest to the middle of the support.
    """

    name: str
    fields: Mapping[str, Any] = field(default_factory=dict)
    support: str = ""
    xy: tuple[float, float] | None = None

    @property
    def label(self) -> str:
        """Return a short description."""
        return f"add {self.name}"

    def edits(self, scene: StudioScene) -> ActEdits:
        """Return the edit that adds the object."""
        require_new_name(self.name, "object", scene.spec.objects)
        data = dict(self.fields)
        asset = data.get("asset")
        if not data.keys() & {"mass", "density", "material", "fixed"} and not (asset and is_document(str(asset))):
            data["mass"] = NEW_MASS
        try:
            item = lowered_object(scene, self.name, data)
        except ValidationError:  # `check` explains better what is wrong with the fields
            return scene_edits(scene, {("objects", self.name): data})
        support = self.support or _largest_support(scene)
        if not support:
            low, _ = hulls(item, X_WO=Pose.of()).bounds()
            data["pose"] = {"xyz": (0, 0, round(-float(low[2]), DIGITS) + 0.0)}
            return scene_edits(scene, {("objects", self.name): data})
        require_object(scene, support)
        xy = self.xy if self.xy is not None else free_place(scene, item, support)
        data["place"] = {"on": support, "xy": tuple(round(float(v), DIGITS) + 0.0 for v in xy)}
        return scene_edits(scene, {("objects", self.name): data})


def lowered_object(scene: StudioScene, name: str, data: Mapping[str, Any]) -> SceneObject:
    """Return a new object as it would be lowered, at the origin.

    Raises:
        ValidationError: If its fields are not valid.
        ActError: If its files cannot be used.
    """
    spec = ObjectSpec.model_validate(data)
    loaded = scene.loaded
    if spec.asset is not None:
        try:
            file = loaded.file(spec.asset)
        except FileError as error:
            raise ActError(str(error)) from None
        if is_document(spec.asset) and loaded.used(spec.asset) is None:
            loaded = replace(loaded, uses={**loaded.uses, str(file): load(file, loaded.root)})
    document = replace(loaded, spec=scene.spec.model_copy(update={"objects": {**scene.spec.objects, name: spec}}))
    work = ObjectLowering(document, Cache.default(), draft=True)
    try:
        item = work.lower(name)
    except (OSError, AssertionError, KeyError):
        item = None
    if item is None:
        reason = work.findings[0].message if work.findings else "its asset cannot be read"
        raise ActError(f"`{name}` cannot be added: {reason}")
    return item


def _largest_support(scene: StudioScene) -> str:
    """Return the fixed object with the largest extent from above, or an empty string."""
    areas = {
        name: float(np.prod((high - low)[:2]))
        for name, (low, high) in scene.draft.bounds.items()
        if scene.objects[name].fixed
    }
    return max(areas, key=lambda name: areas[name], default="")


def free_place(scene: StudioScene, item: SceneObject, support: str) -> tuple[float, float]:
    """Return the free place (x, y) [m] on a support that is nearest to its middle, or its middle if there is none."""
    low, high = hulls(item, X_WO=Pose.of()).bounds()
    least, most = scene.draft.bounds[support]
    middle = np.round((least + most)[:2] / 2, 2)
    others = [box for name, box in scene.draft.bounds.items() if name != support]
    for place in _rings(middle):
        box_low, box_high = low[:2] + np.array(place), high[:2] + np.array(place)
        on_it = (box_low >= least[:2]).all() and (box_high <= most[:2]).all()
        free = all(
            (box_low - FREE_M > b[:2]).any() or (box_high + FREE_M < a[:2]).any()
            for a, b in others
            if b[2] > most[2]  # what ends below the top of the support is not in the way
        )
        if on_it and free:
            return place
    return float(middle[0]), float(middle[1])


def _rings(middle: Array) -> Iterator[tuple[float, float]]:
    """Yield places around a point [m], the nearest ones first."""
    steps = range(-RINGS, RINGS + 1)
    for i, j in sorted(((i, j) for i in steps for j in steps), key=lambda ij: (ij[0] ** 2 + ij[1] ** 2, ij)):
        yield round(float(middle[0]) + i * STEP_M, 3), round(float(middle[1]) + j * STEP_M, 3)
