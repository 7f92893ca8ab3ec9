"""``physics.json``: what URDF has no place for and its simulators can hold, as gravity, surfaces and armature."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Protocol

from simfoundry.backends.artifact import json_text, rounded
from simfoundry.scene.frames import Pose
from simfoundry.scene.model import Geometry, JointType, Link, Scene, SceneObject
from simfoundry.scene.touching import silent_pairs
from simfoundry.scene.trees import Tree, trees


class Split(Protocol):
    """Splits a geometry into the parts that are written, each with a suffix for its name."""

    def __call__(self, geometry: Geometry, /) -> Iterator[tuple[str, Geometry, Pose]]:
        """The parts in the order of the file."""
        ...


def physics_manifest(scene: Scene, split: Split, robots: Iterable[SceneObject] = ()) -> bytes:
    """The file; collision shapes go by the names and in the order of the URDF.

    ``robots`` are those that were converted; of one with a URDF of its own there is nothing to add.
    """
    data: dict[str, object] = {
        "gravity": [rounded(v) for v in scene.gravity],
        "objects": {tree.name: _object(tree, split) for item in (*scene.objects, *robots) for tree in trees(item)},
    }
    return json_text(data)


def _object(tree: Tree, split: Split) -> dict[str, object]:
    """What one URDF lacks: an object, or a part of one that moves freely."""
    joints = {
        joint.name: {"friction": rounded(joint.friction), "armature": rounded(joint.armature)}
        for joint in tree.joints
        if joint.type is not JointType.FIXED
    }
    links = {link.name: _surfaces(link, split) for link in tree.links}
    silent = [list(pair) for pair in silent_pairs(tree.owner) if links.keys() >= set(pair)]
    return {"links": links, "joints": joints, "silent": silent}


def _surfaces(link: Link, split: Split) -> dict[str, dict[str, float]]:
    return {
        collider.name + suffix: {
            "friction": rounded(collider.friction),
            "restitution": rounded(collider.restitution),
        }
        for collider in link.colliders
        for suffix, _, _ in split(collider.geometry)
    }
