"""Effective inertias at the joints of an object."""

from __future__ import annotations

import numpy as np

from simfoundry.geometry.frames import Array
from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.model import Joint, JointType
from simfoundry.scene.trees import Tree


def effective_inertias(tree: Tree) -> dict[str, float]:
    """Inertia felt by a force at each one-axis joint in the initial state [kg m^2 or kg], by joint name.

    All other joints move freely, without friction or motors, so this is the smallest possible value.
    """
    columns, names = _columns(tree)
    mass_matrix = np.zeros((len(columns), len(columns)))
    X_OL = link_poses(tree.owner)
    carried = _carried(tree)
    for link in tree.links:
        rotation = X_OL[link.name].rotation
        com, turned = X_OL[link.name].apply(link.com), rotation @ link.inertia @ rotation.T
        linear, angular = np.zeros((3, len(columns))), np.zeros((3, len(columns)))
        for k, (joint, point, axis, slides) in enumerate(columns):
            if joint is None or joint.name in carried[link.name]:
                linear[:, k] = axis if slides else np.cross(axis, com - point)
                angular[:, k] = 0.0 if slides else axis
        mass_matrix += link.mass * linear.T @ linear + angular.T @ turned @ angular
    mass_matrix += np.diag([0.0 if joint is None else joint.armature for joint, *_ in columns])
    felt = 1.0 / np.diag(np.linalg.inv(mass_matrix)) if columns else np.zeros(0)
    return {name: float(value) for name, value in zip(names, felt, strict=True) if name}


_Column = tuple[Joint | None, Array, Array, bool]
"""One degree of freedom: the joint, or None for the free root; a point on its axis, the axis, and whether it slides."""


def _columns(tree: Tree) -> tuple[list[_Column], list[str]]:
    """Degrees of freedom of a tree, in the object's frame, and the joint of each that has one axis."""
    X_OL = link_poses(tree.owner)
    columns: list[_Column] = []
    names: list[str] = []
    if not tree.fixed:
        origin = X_OL[tree.root.name].p
        columns += [(None, origin, axis, slides) for slides in (True, False) for axis in np.eye(3)]
    names += [""] * len(columns)
    for joint in tree.joints:
        origin, rotation = X_OL[joint.child].p, X_OL[joint.child].rotation
        if joint.type is JointType.BALL:
            columns += [(joint, origin, axis, False) for axis in rotation.T]
            names += [""] * 3
        elif joint.has_axis:
            columns.append((joint, origin, rotation @ joint.axis, joint.type is JointType.PRISMATIC))
            names.append(joint.name)
    return columns, names


def _carried(tree: Tree) -> dict[str, frozenset[str]]:
    """Joints between the root and each link, by link."""
    above: dict[str, frozenset[str]] = {tree.root.name: frozenset()}
    carriers = {joint.child: joint for joint in tree.joints}
    for link in tree.links[1:]:
        joint = carriers[link.name]
        above[link.name] = above[joint.parent] | {joint.name}
    return above
