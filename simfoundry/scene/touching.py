"""Which links may touch each other, the same in every target.

Links that a joint connects never touch, as far as the joint holds them: welded links count as one, a free joint holds
nothing. All other links touch, of one object too, but for the pairs that the spec names.
"""

from __future__ import annotations

from itertools import combinations

from simfoundry.scene.model import JointType, SceneObject


def excluded_link_pairs(item: SceneObject) -> tuple[tuple[str, str], ...]:
    """Pairs of links of an object that do not touch, by name, in the order of the links."""
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
    """Pairs of links of an object that can touch each other, by name, in the order of the links."""
    if len(item.links) == 1:
        return ()
    silent = set(excluded_link_pairs(item))
    felt = [link.name for link in item.links if link.colliders]
    return tuple(pair for pair in combinations(felt, 2) if pair not in silent)


def weld_groups(item: SceneObject) -> dict[str, str]:
    """The first link of those that each link is welded to, by link."""
    groups: dict[str, str] = {}
    carriers = {joint.child: joint for joint in item.joints}
    for link in item.links:
        joint = carriers.get(link.name)
        welded = joint is not None and joint.type is JointType.FIXED
        groups[link.name] = groups[joint.parent] if joint is not None and welded else link.name
    return groups
