"""Kinematic trees of an object, separated by its free joints."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from simfoundry.geometry.frames import Pose
from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.model import Joint, JointType, Link, SceneObject


@dataclass(frozen=True, eq=False)
class Tree:
    """Links of an object connected by constraining joints; the first is the root.

    ``free_joint`` is the free joint above the root, None if the root is the object's own; ``joints`` are those within
    the tree. ``X_WT`` is the pose of the root link's frame in the world.
    """

    owner: SceneObject
    links: tuple[Link, ...]
    joints: tuple[Joint, ...]
    free_joint: Joint | None
    X_WT: Pose

    @property
    def root(self) -> Link:
        """First link: the object's root link, or the child of a free joint."""
        return self.links[0]

    @property
    def name(self) -> str:
        """Qualified name of the root: the object's own name, or ``object.link``."""
        return self.owner.qualified(self.root.name)

    @property
    def fixed(self) -> bool:
        """True if the root is welded to the world."""
        return self.owner.fixed and self.free_joint is None


def free_motions(item: SceneObject, positions: Mapping[str, float | Pose], X_OT: Mapping[str, Pose]) -> dict[str, Pose]:
    """Motions of an object's free joints, by name, from the poses ``X_OT`` of the links below them, by name.

    ``positions`` are those of its other joints.
    """
    known, motions = dict(positions), dict[str, Pose]()
    for joint in (tree.free_joint for tree in trees(item)):
        if joint is not None:
            X_OZ = link_poses(item, known)[joint.parent] @ joint.X_PC
            known[joint.name] = motions[joint.name] = X_OZ.inverse() @ X_OT[joint.child]
    return motions


def trees(item: SceneObject) -> tuple[Tree, ...]:
    """Trees of an object in the order of their roots; a single one if it has no free joint."""
    free = {joint.child: joint for joint in item.joints if joint.type is JointType.FREE} if item.joints else {}
    if not free:
        return (Tree(item, item.links, item.joints, None, item.X_WO),)
    X_OL = link_poses(item)
    carriers = {joint.child: joint for joint in item.joints}
    roots: dict[str, str] = {}
    for link in item.links:
        is_root = link is item.root or link.name in free
        roots[link.name] = link.name if is_root else roots[carriers[link.name].parent]
    return tuple(
        Tree(
            owner=item,
            links=tuple(link for link in item.links if roots[link.name] == root),
            joints=tuple(j for j in item.joints if j.type is not JointType.FREE and roots[j.child] == root),
            free_joint=free.get(root),
            X_WT=item.X_WO @ X_OL[root],
        )
        for root in dict.fromkeys(roots.values())
    )
