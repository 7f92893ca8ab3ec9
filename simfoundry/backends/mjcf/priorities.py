"""Which surface of two that move decides their contact, so that few need a ``<pair>``.

MuJoCo tests each ``<pair>`` in every step, hull by hull, wherever its bodies are; what it finds by itself it prunes
first. Where two priorities differ, the geom of the higher one decides alone. So a surface can be written as what it
makes of contacts with one other surface, above that in priority: as many kinds of contact as there are surfaces but one
need no pairs, a forest in which each surface decides over the one below it. What it costs are the contacts of the
surface with itself, where several bodies have it: these then need pairs.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence

from simfoundry.backends.mjcf.surfaces import Felt, Surface, Way, happens, meant

WORTH = 16
"""So few pairs are not worth writing a surface as what it is not."""


def ways(moving: Mapping[Surface, Sequence[Felt]], bound: Collection[Surface]) -> dict[Surface, Way]:
    """How to write each surface of what can move; those that are ``bound`` stay what they are.

    All priorities are 0 or less, and below 0 where any differs: a geom of somebody else's, a robot's, has 0.
    """
    above = _forest({s: group for s, group in moving.items() if s not in bound})
    if not above:
        return {surface: Way(0, surface) for surface in moving}
    depths = {surface: _depth(surface, above) for surface in {*above, *above.values()}}
    top = max(depths.values()) + 1
    out: dict[Surface, Way] = {}
    for surface in moving:
        written = meant(surface, above[surface]) if surface in above else surface
        out[surface] = Way(depths[surface] - top if surface in depths else 0, written)
    return out


def _depth(surface: Surface, above: Mapping[Surface, Surface]) -> int:
    depth = 0
    while surface in above:
        surface, depth = above[surface], depth + 1
    return depth


def _forest(moving: Mapping[Surface, Sequence[Felt]]) -> dict[Surface, Surface]:
    """By surface the one that it decides over: those that save most pairs, without a circle."""
    order = list(moving)
    own = {surface: _own_pairs(moving[surface]) for surface in order}
    found = []
    for i, one in enumerate(order):
        for j, other in enumerate(order):
            saved = len(moving[one]) * len(moving[other]) - own[one]
            if i != j and saved >= WORTH and not happens(Way(0, one), Way(0, other), meant(one, other)):
                found.append((-saved, i, j))
    above: dict[Surface, Surface] = {}
    tree = list(range(len(order)))
    for _, i, j in sorted(found):
        if order[i] not in above and tree[i] != tree[j]:
            above[order[i]] = order[j]
            old, new = tree[i], tree[j]
            tree = [new if k == old else k for k in tree]
    return above


def _own_pairs(group: Sequence[Felt]) -> int:
    """How many pairs of geoms of different links there are in a group."""
    by_link = Counter(surface.link for surface in group)
    return (len(group) ** 2 - sum(n * n for n in by_link.values())) // 2
