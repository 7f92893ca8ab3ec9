"""The kinematics of objects: link poses, kinematic trees, effective inertias, and pairs of links that can touch."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from simfoundry.geometry.frames import IDENTITY, Array, Pose
from simfoundry.scene.model import Joint, JointType, Link, SceneObject


def joint_transform(joint: Joint, position: float | Pose) -> Pose:
    """Return the pose of the child link relative to its pose at position zero.

    ``position`` is the position of a single-axis joint [rad or m], or the motion of a ball or free joint.
    """
    if isinstance(position, Pose):
        return position
    match joint.type:
        case JointType.PRISMATIC:
            return Pose.of(joint.axis * position)
        case JointType.REVOLUTE | JointType.CONTINUOUS:
            return Pose.about(joint.axis, position)
    return IDENTITY


def link_poses(item: SceneObject, joints: Mapping[str, float | Pose] | None = None) -> dict[str, Pose]:
    """Return the pose ``X_OL`` of every link in the object frame, keyed by link name.

    ``joints`` maps joint names to the positions [rad or m] or the motions (of ball and free joints) that replace those
    of the object.
    """
    poses = {item.root.name: IDENTITY}
    for link in item.links[1:]:
        above = item.joints_above[link.name]
        X_OL = poses[above[0].parent]
        for joint in above:
            position: float | Pose = joint.position if joint.has_axis else joint.motion
            if joints is not None:
                position = joints.get(joint.name, position)
            X_OL = X_OL @ joint.X_PC @ joint_transform(joint, position)
        poses[link.name] = X_OL
    return poses


def axis_frame(item: SceneObject, joint: Joint, X_OL: Mapping[str, Pose]) -> Pose:
    """Return the pose of a joint in the object frame, in which its axis is expressed, given the poses of the links.

    This is the pose of the child, without the motion along and about the axes after this one.
    """
    X_OJ, above = X_OL[joint.child], item.joints_above[joint.child]
    for after in reversed(above[above.index(joint) + 1 :]):
        X_OJ = X_OJ @ joint_transform(after, after.position if after.has_axis else after.motion).inverse()
    return X_OJ


@dataclass(frozen=True, eq=False)
class Tree:
    """The links of an object that are connected by constraining joints. The first link is the root.

    ``free_joint`` is the free joint above the root, or None if the root is the root of the object. ``joints`` are the
    joints within the tree. ``X_WT`` is the pose of the root link's frame in the world.
    """

    owner: SceneObject
    links: tuple[Link, ...]
    joints: tuple[Joint, ...]
    free_joint: Joint | None
    X_WT: Pose

    @property
    def root(self) -> Link:
        """The first link, which is either the object's root link or the child of a free joint."""
        return self.links[0]

    @property
    def name(self) -> str:
        """The qualified name of the root: the name of the object, or ``object.link``."""
        return self.owner.qualified(self.root.name)

    @property
    def fixed(self) -> bool:
        """True if the root is welded to the world."""
        return self.owner.fixed and self.free_joint is None


def free_motions(item: SceneObject, positions: Mapping[str, float | Pose], X_OT: Mapping[str, Pose]) -> dict[str, Pose]:
    """Compute the motions of an object's free joints from the poses of their child links.

    Args:
        item: The object.
        positions: Positions of the object's other joints, keyed by joint name.
        X_OT: Poses of the free joints' child links in the object frame, keyed by link name.

    Returns:
        The motion of each free joint, keyed by joint name.
    """
    known, motions = dict(positions), dict[str, Pose]()
    for joint in (tree.free_joint for tree in trees(item)):
        if joint is not None:
            X_OZ = link_poses(item, known)[joint.parent] @ joint.X_PC
            known[joint.name] = motions[joint.name] = X_OZ.inverse() @ X_OT[joint.child]
    return motions


def trees(item: SceneObject) -> tuple[Tree, ...]:
    """Return an object's kinematic trees in the order of their roots. Without free joints, there is only one tree."""
    free = {joint.child: joint for joint in item.joints if joint.type is JointType.FREE} if item.joints else {}
    if not free:
        return (Tree(item, item.links, item.joints, None, item.X_WO),)
    X_OL = link_poses(item)
    roots: dict[str, str] = {}
    for link in item.links:
        is_root = link is item.root or link.name in free
        roots[link.name] = link.name if is_root else roots[item.joints_above[link.name][0].parent]
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


def effective_inertias(tree: Tree) -> dict[str, float]:
    """Return the effective inertia [kg m^2 or kg] at each single-axis joint in the initial state, keyed by joint name.

    All other joints move freely, without friction or motors, so the result is the smallest possible value.
    """
    columns = _columns(tree)
    mass_matrix = np.zeros((len(columns), len(columns)))
    X_OL = link_poses(tree.owner)
    above: dict[str, frozenset[str]] = {}  # the joints between the root and each link, by link name
    for link in tree.links:
        own = () if link is tree.root else tree.owner.joints_above[link.name]
        above[link.name] = above[own[0].parent].union(joint.name for joint in own) if own else frozenset()
        rotation = X_OL[link.name].rotation
        com, turned = X_OL[link.name].apply(link.com), rotation @ link.inertia @ rotation.T
        linear, angular = np.zeros((3, len(columns))), np.zeros((3, len(columns)))
        for k, (joint, point, axis, slides) in enumerate(columns):
            if joint is None or joint.name in above[link.name]:
                linear[:, k] = axis if slides else np.cross(axis, com - point)
                angular[:, k] = 0.0 if slides else axis
        mass_matrix += link.mass * linear.T @ linear + angular.T @ turned @ angular
    joints = [joint for joint, *_ in columns]
    mass_matrix += np.diag([0.0 if joint is None else joint.armature for joint in joints])
    effective = 1.0 / np.diag(np.linalg.inv(mass_matrix)) if columns else np.zeros(0)
    return {j.name: float(v) for j, v in zip(joints, effective, strict=True) if j is not None and j.has_axis}


# A degree of freedom: its joint (None for the free root), a point on its axis, the axis, and True if it slides.
_Column = tuple[Joint | None, Array, Array, bool]


def _columns(tree: Tree) -> list[_Column]:
    """Return the degrees of freedom of a tree, expressed in the object frame."""
    X_OL = link_poses(tree.owner)
    columns: list[_Column] = []
    if not tree.fixed:
        origin = X_OL[tree.root.name].p
        columns += [(None, origin, axis, slides) for slides in (True, False) for axis in np.eye(3)]
    for joint in tree.joints:
        X_OJ = axis_frame(tree.owner, joint, X_OL)
        origin, rotation = X_OJ.p, X_OJ.rotation
        if joint.type is JointType.BALL:
            columns += [(joint, origin, axis, False) for axis in rotation.T]
        elif joint.has_axis:
            columns.append((joint, origin, rotation @ joint.axis, joint.type is JointType.PRISMATIC))
    return columns


def excluded_link_pairs(item: SceneObject) -> tuple[tuple[str, str], ...]:
    """Return the names of all pairs of links within an object whose contacts are disabled, in link order."""
    if len(item.links) == 1:
        return ()
    welded = weld_groups(item)
    joints = [joint for joint in item.joints if joint.type is not JointType.FREE]
    joined = {frozenset((welded[joint.parent], welded[joint.child])) for joint in joints}
    named = {frozenset(pair) for pair in item.no_contact}
    return tuple(
        (a.name, b.name)
        for a, b in combinations(item.links, 2)
        if welded[a.name] == welded[b.name]
        or frozenset((welded[a.name], welded[b.name])) in joined
        or frozenset((a.name, b.name)) in named
    )


def contact_pairs(item: SceneObject) -> tuple[tuple[str, str], ...]:
    """Return the names of all pairs of links within an object that can be in contact, in link order."""
    if len(item.links) == 1:
        return ()
    excluded = set(excluded_link_pairs(item))
    solid = [link.name for link in item.links if link.colliders]
    return tuple(pair for pair in combinations(solid, 2) if pair not in excluded)


def weld_groups(item: SceneObject) -> dict[str, str]:
    """Map each link to the first link in the group of links welded to it."""
    groups: dict[str, str] = {}
    for link in item.links:
        above = item.joints_above.get(link.name, ())
        welded = bool(above) and above[0].type is JointType.FIXED
        groups[link.name] = groups[above[0].parent] if welded else link.name
    return groups
