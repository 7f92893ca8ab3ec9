"""Reuse of objects from an earlier lowering of the same document, of which an editor has changed a few characters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from simfoundry.geometry.frames import Pose
from simfoundry.scene.frames import FrameTree
from simfoundry.scene.model import SceneObject
from simfoundry.scene.place import Placement, needs
from simfoundry.spec.models.scene import SceneSpec


@dataclass(frozen=True, eq=False)
class EarlierLowering:
    """The objects of an earlier draft, which can stand in for those of a new one where nothing they depend on differs.

    Only objects with a shape are reused: what meshes, textures and assets contain can change on disk.

    Attributes:
        spec: The document.
        viewer: The frame of its viewpoint.
        lowered: The objects before they were placed, by name.
        placed: The objects after they were placed, by name.
    """

    spec: SceneSpec
    viewer: Pose | None
    lowered: Mapping[str, SceneObject]
    placed: Mapping[str, SceneObject]

    def has_same_materials(self, spec: SceneSpec) -> bool:
        """Return True if a document has the same materials, and none of them has a texture."""
        return spec.materials == self.spec.materials and all(m.texture is None for m in spec.materials.values())

    def lowered_object(self, name: str, spec: SceneSpec) -> SceneObject | None:
        """Return the object before it was placed if it has a shape and is the same in a document, or None.

        The materials must be the same.
        """
        item = spec.objects[name]
        if item.shape is None or item.visual is not None or item.variants or name not in self.lowered:
            return None
        return self.lowered[name] if item == self.spec.objects.get(name) else None

    def has_same_frames(self, spec: SceneSpec, viewer: Pose | None) -> bool:
        """Return True if all that placements can refer to, except objects, is the same in a document."""
        old = self.spec
        same = (spec.frames, spec.cameras, spec.robots, spec.viewpoint) == (
            old.frames, old.cameras, old.robots, old.viewpoint
        )  # fmt: skip
        if viewer is None or self.viewer is None:
            return same and viewer is self.viewer
        return same and viewer.p.tolist() == self.viewer.p.tolist() and viewer.q.tolist() == self.viewer.q.tolist()

    def placed_object(
        self, item: SceneObject, place: Placement, placed: Mapping[str, SceneObject], frames: FrameTree
    ) -> SceneObject | None:
        """Return the placed object if it and the objects that it depends on are those of the earlier draft, or None.

        The frames must be the same; a placement is compared with the object, because it is a part of it.
        """
        if self.lowered.get(item.name) is not item:
            return None
        if any(placed.get(other) is not self.placed.get(other) for other in needs(place, frames)):
            return None
        return self.placed.get(item.name)
