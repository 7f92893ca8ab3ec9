"""Which MuJoCo geoms touch, and how, so that each contact is what its two surfaces mean together.

MuJoCo takes the larger friction of two geoms where the scene means the geometric mean. What makes that right:

- Two alike are right by MuJoCo's own rule.
- What can never move gets a twin for each contact that its surface makes: a geom at the same place in a body of its
  own, ``table:touch1``, which feels as that contact does and decides alone. Masks let it meet only what it is for.
- Of two that move, the priority of one may decide: see :mod:`simfoundry.backends.mjcf.priorities`.
- An explicit ``<pair>`` for each two geoms, where these are few or nothing else is left. MuJoCo tests them in each
  step, hull by hull, even where their bodies are far apart: 14 ns each then, and 0.7 us near a table.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations, product

from simfoundry.backends.mjcf.foreign_geoms import Guests
from simfoundry.backends.mjcf.priorities import WORTH, ways
from simfoundry.backends.mjcf.surfaces import (
    Felt,
    Surface,
    Way,
    alike,
    felt,
    geom_attributes,
    happens,
    meant,
    pair_attributes,
    resists,
)
from simfoundry.scene.model import Scene
from simfoundry.scene.touching import silent_pairs

Groups = Mapping[Surface, Sequence[Felt]]

_OPEN = 1
"""The bit of masks that everything has which touches anything, geoms that are not ours included."""


@dataclass(frozen=True)
class Twin:
    """How what does not move touches some of what moves: ``contact`` is what it feels like, ``mask`` whom it meets."""

    contact: Surface
    mask: int


@dataclass
class Contacts:
    """How the geoms of a scene are written, and which pairs need more than that.

    ``ways`` are the surfaces of what can move; ``twins`` by surface those of what cannot, whose own geoms then meet
    what is in ``native`` only; ``bits`` what the masks call each surface of what moves; ``shared`` the bit with which
    the moving meet each other, 0 where no masks are needed. ``pairs`` are groups of geoms with the contacts they make.
    """

    groups: Groups
    static: frozenset[str]
    resisting: bool
    ways: Mapping[Surface, Way]
    shared: int = 0
    bits: dict[Surface, int] = field(default_factory=dict)
    twins: dict[Surface, list[Twin]] = field(default_factory=dict)
    native: dict[Surface, int] = field(default_factory=dict)
    pairs: list[tuple[Sequence[Felt], Sequence[Felt], Surface]] = field(default_factory=list)

    def own(self, surface: Surface, link: str) -> dict[str, str]:
        """Attributes of the geom of a surface of a link, which is called by its qualified name."""
        if link in self.static:
            masks = {"contype": str(self.native[surface]), "conaffinity": str(_OPEN)} if surface in self.native else {}
            return masks | geom_attributes(surface, self.resisting)
        way = self.ways[surface]
        met = _OPEN | self.shared | self.bits.get(surface, 0)
        masks = {"contype": str(self.shared), "conaffinity": str(met)} if self.shared else {}
        priority = {"priority": str(way.priority)} if way.priority else {}
        return masks | priority | geom_attributes(way.surface, self.resisting)

    def twins_of(self, surface: Surface, link: str) -> list[Twin]:
        """The twins of each geom of a surface of a link."""
        return self.twins.get(surface, []) if link in self.static else []

    def twin(self, twin: Twin) -> dict[str, str]:
        """Attributes of a twin, which decides over whatever it meets."""
        masks = {"contype": str(twin.mask), "conaffinity": "0", "priority": "1", "group": "4"}
        return masks | geom_attributes(twin.contact, self.resisting)

    def changed(self, collider_surface: Surface, link: str) -> bool:
        """Whether a geom is written as another surface than its own."""
        return link not in self.static and not alike(self.ways[collider_surface].surface, collider_surface)


def twin_body(link: str, mask: int) -> str:
    """The name of the body of those twins of a link that have a mask; only our names have colons."""
    return f"{link}:touch{mask}"


def contacts_of(scene: Scene, guests: Guests) -> Contacts:
    """How to write the contacts of a scene, among geoms that are not of the scene itself: its robots'."""
    moving: dict[Surface, list[Felt]] = {}
    fixed: dict[Surface, list[Felt]] = {}
    for item in scene.objects:
        for geom in felt(item):
            (fixed if geom.static else moving).setdefault(geom.surface, []).append(geom)
    static = frozenset(geom.link for group in fixed.values() for geom in group)
    decided = ways(moving, [s for s in moving if not guests.decide_over(s)])
    plan = Contacts(moving, static, resists(scene), decided)
    for a, b in combinations(moving, 2):
        if not happens(decided[a], decided[b], meant(a, b)):
            plan.pairs.append((moving[a], moving[b], meant(a, b)))
    for surface, group in moving.items():
        if not happens(decided[surface], decided[surface], surface):
            plan.pairs.append((group, group, surface))
    _add_twins(plan, fixed, guests.free_bits())
    return plan


def _add_twins(plan: Contacts, fixed: Groups, free: Sequence[int]) -> None:
    """Twins for what does not move, with the ``free`` bits of masks; pairs for few, and for what no bits are left."""
    told = dict(zip(sorted(plan.groups, key=lambda s: -len(plan.groups[s])), free[1:], strict=False))
    for a, standing in fixed.items():
        unlike = [b for b in plan.groups if not happens(Way(0, a), plan.ways[b], meant(a, b))]
        twinned = len(standing) * sum(len(plan.groups[b]) for b in unlike) >= WORTH and bool(told)
        masks: dict[Surface, int] = {}
        for b in plan.groups if twinned else unlike:
            if twinned and b in told:
                if b in unlike:
                    masks[meant(a, b)] = masks.get(meant(a, b), 0) | told[b]
            else:
                plan.pairs.append((standing, plan.groups[b], meant(a, b)))
        if twinned:
            plan.native[a] = sum(bit for b, bit in told.items() if b not in unlike)
            plan.twins[a] = [Twin(contact, mask) for contact, mask in masks.items()]
    if plan.twins:
        plan.shared, plan.bits = free[0], told


def add_contacts(root: ET.Element, scene: Scene, plan: Contacts) -> None:
    """Add ``<contact>``: links that do not touch, and the pairs that need an entry of their own."""
    contact = ET.SubElement(root, "contact")
    silent = [(o.qualified(a), o.qualified(b)) for o in scene.objects for a, b in silent_pairs(o)]
    silent += scene.no_contact
    bodies = _bodies(scene, plan) if silent else {}
    for a, b in silent:
        for one, other in product(bodies.get(a, [a]), bodies.get(b, [b])):
            if other == b or one == a:  # of what is fixed, nothing meets
                ET.SubElement(contact, "exclude", body1=one, body2=other)
    unheard = {frozenset(pair) for pair in silent}
    for group_a, group_b, surface in plan.pairs:
        attributes = pair_attributes(surface)
        for this, that in combinations(group_a, 2) if group_a is group_b else product(group_a, group_b):
            if this.link == that.link:
                continue
            if not unheard or frozenset((this.link, that.link)) not in unheard:
                ET.SubElement(contact, "pair", {"geom1": this.geom, "geom2": that.geom} | attributes)


def _bodies(scene: Scene, plan: Contacts) -> dict[str, list[str]]:
    """By link with twins, the bodies that its geoms are in."""
    out: dict[str, list[str]] = {}
    for geom in (geom for item in scene.objects for geom in felt(item)):
        for twin in plan.twins_of(geom.surface, geom.link):
            names = out.setdefault(geom.link, [geom.link])
            if twin_body(geom.link, twin.mask) not in names:
                names.append(twin_body(geom.link, twin.mask))
    return out
