"""Set properties of objects: mass, density, friction, restitution, material, category, color, fixed, collision."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from pydantic import ValidationError

from simfoundry.spec.change.edit_data import DataPath
from simfoundry.spec.change.merge.conflict import ABSENT
from simfoundry.spec.models.scene import ObjectSpec
from simfoundry.spec.models.types import RIVALS, field_adapter
from simfoundry.studio.acts.act import ActEdits, ActError, require_object, scene_edits
from simfoundry.studio.reading import StudioScene


@dataclass(frozen=True)
class SetProperties:
    """Set properties of an object. A value of None removes the property, so that its default applies.

    Attributes:
        name: The object.
        values: Plain values by key, such as ``{"mass": 0.3}``. Keys that exclude a new one are removed.
    """

    name: str
    values: Mapping[str, Any] = field(default_factory=dict)

    @property
    def label(self) -> str:
        """Return a short description."""
        return f"set {', '.join(self.values)} of {self.name}"

    def edits(self, scene: StudioScene) -> ActEdits:
        """Return the edits of the object."""
        require_object(scene, self.name)
        edits: dict[DataPath, Any] = {}
        written = scene.loaded.document.data["objects"][self.name] if scene.loaded.document is not None else {}
        for key, value in self.values.items():
            if key not in ObjectSpec.model_fields:
                raise ActError(f"objects have no property `{key}`")
            if value is None:
                edits["objects", self.name, key] = ABSENT
                continue
            try:
                field_adapter(ObjectSpec, key).validate_python(value, strict=True)
            except ValidationError as error:
                raise ActError(f"`{key}` of `{self.name}`: {error.errors()[0]['msg']}") from None
            edits["objects", self.name, key] = value
            for rival in RIVALS.get(key, set()) & written.keys():
                edits["objects", self.name, rival] = ABSENT
        return scene_edits(scene, edits)
