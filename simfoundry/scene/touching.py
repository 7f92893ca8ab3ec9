"""Pairs of links that can be in contact, the same in every target.

Links connected by a joint do not collide if the joint constrains them: welded links count as one, and a free joint
constrains nothing. All other links collide, including those of one object, except for the pairs that the spec excludes.
"""

from __future__ import annotations

from itertools import combinations

from simfoundry.scene.model import JointType, SceneObject


def excluded_link_pairs(item: SceneObject) -> tuple[tuple[str, str], ...]:
    """Pairs of links of an object without contacts, by name, in the order of the links."""
    if len(item.links) == 1:
        return ()
    welded = weld_groups(item)
    joined = {
        frozenset((welded[joint.parent], welded[joint.child]))
        for joint in item.joints
        if joint.type is not JointType.FREE
    }
    named = {frozenset(pair) for pair in item.no_contact}
    return tuple(
        (a.name, b.name)
        for a, b in combinations(item.links, 2)
        if welded[a.name] == welded[b.name]
        or frozenset((welded[a.name], welded[b.name])) in joined
        or frozenset((a.name, b.name)) in named
    )


def contact_pairs(item: SceneObject) -> tuple[tuple[str, str], ...]:
    """Pairs of links of an object that can be in contact, by name, in the order of the links."""
    if len(item.links) == 1:
        return ()
    silent = set(excluded_link_pairs(item))
    felt = [link.name for link in item.links if link.colliders]
    return tuple(pair for pair in combinations(felt, 2) if pair not in silent)


def weld_groups(item: SceneObject) -> dict[str, str]:
    """For each link, the first link of the group that is welded to it."""
    groups: dict[str, str] = {}
    carriers = {joint.child: joint for joint in item.joints}
    for link in item.links:
        joint = carriers.get(link.name)
        welded = joint is not None and joint.type is JointType.FIXED
        groups[link.name] = groups[joint.parent] if joint is not None and welded else link.name
    return groups
