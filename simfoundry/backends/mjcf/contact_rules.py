"""Exact contact friction in MuJoCo: each pair of surfaces uses the geometric mean of both friction coefficients.

MuJoCo uses the larger friction of two geoms and averages their damping. In a scene, a pair uses the geometric mean of
both friction coefficients and of both restitutions, and the larger resistance to spinning and rolling. Every geom
stores only its own values: ``friction``, and the restitution as ``user`` data, because MuJoCo does not support
restitution. Two surfaces are called unlike if MuJoCo's rule combines them incorrectly. Such pairs are corrected in two
ways:

- :func:`contacts_text` writes ``contacts.xml``, which the scene includes, with a ``<pair>`` for every two unlike geoms
  that can collide. This works in every program that opens the scene, but MuJoCo tests each pair in every step.
- :func:`make_exact`, which `load()` calls, modifies a specification in memory. If a group of unlike geoms is so large
  that it may exceed :data:`MAX_PAIRS`, the function adds invisible proxy geoms in the same place as the geoms with one
  of the surfaces. Proxies have the desired contact properties, take priority over the other surface, and collide only
  with it.

Contacts with geoms that do not belong to the scene, such as robot geoms, still follow MuJoCo's rule.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from itertools import combinations, product
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    import mujoco

# The file that lists the contact pairs; ``scene.xml`` in the same folder includes it.
CONTACTS_FILE = "contacts.xml"

# The content of :data:`CONTACTS_FILE` if there are no pairs; MuJoCo cannot include a file without elements.
EMPTY = "<mujoco>\n  <contact />\n</mujoco>\n"

# Maximum number of pairs in the file. This corresponds to 200 kB of text, and 40 us per step if no geoms are close.
MAX_PAIRS = 3000

# Minimum number of pairs for which proxy geoms are used; fewer pairs are cheaper than proxies. MuJoCo tests a pair in
# 14 ns if its geoms are far apart and in 0.7 us near a table, but it must update moving proxy geoms in every step.
# Measured with `tests/benchmarks/stepping.py`: among values from 16 to 300 for moving geoms, 150 was the fastest.
MIN_STATIC_PAIRS, MIN_MOVING_PAIRS = 16, 150

# The name of the custom text that lists robot bodies, whose contacts are not changed.
ROBOTS = "simfoundry:robots"

# The first part of the suffix in the names of proxy geoms and bodies; names in a scene do not contain colons.
PROXY = ":proxy"

# Time constant of a contact [s], which is MuJoCo's default. At 0.008, a bowl dropped from 2 cm penetrates a table by
# 1.5 mm instead of 4 mm, but below 0.012, a can lying on its side rolls away.
_CONTACT_TIME = 0.02

# Number of usable bits in a mask, which excludes the sign bit.
_MASK_BITS = 31


class ContactSurface(NamedTuple):
    """The friction, restitution, and resistance to spinning and rolling [m] of a collider or a contact."""

    friction: float
    restitution: float
    spinning: float
    rolling: float


class ContactGeom(NamedTuple):
    """A collision geom with its name, body, static flag, surface, material class and contact masks."""

    name: str
    body: str
    static: bool
    surface: ContactSurface
    material: str
    contype: int = 1
    conaffinity: int = 1


class UnlikeGroup(NamedTuple):
    """Two groups of geoms whose surfaces MuJoCo combines incorrectly. Static geoms are always in the first group."""

    one: Sequence[ContactGeom]
    other: Sequence[ContactGeom]
    contact: ContactSurface


# Pairs of bodies that do not collide.
Excluded = frozenset[frozenset[str]]

# The mask bit of each surface of a moving geom.
Bits = Mapping[ContactSurface, int]


def desired_contact(a: ContactSurface, b: ContactSurface) -> ContactSurface:
    """Return the contact properties intended for two surfaces in contact."""
    if a == b:
        return a
    return ContactSurface(
        math.sqrt(a.friction * b.friction),
        math.sqrt(a.restitution * b.restitution),
        max(a.spinning, b.spinning),
        max(a.rolling, b.rolling),
    )


def is_native(a: ContactSurface, b: ContactSurface) -> bool:
    """Return true if MuJoCo's own rule yields the desired contact properties for the two geoms."""
    contact = desired_contact(a, b)
    slides = format_number(max(a.friction, b.friction)) == format_number(contact.friction)
    return slides and solref(a.restitution) == solref(b.restitution) == solref(contact.restitution)


def format_number(value: float) -> str:
    """Format a number with twelve significant digits."""
    return f"{value:.12g}"


def solref(restitution: float) -> tuple[float, float]:
    """Return MuJoCo's time constant [s] and damping ratio for a contact with the given restitution.

    The stiffness matches MuJoCo's default contact; only the damping depends on the restitution.
    """
    ratio = damping_ratio(restitution)
    return _CONTACT_TIME / ratio, ratio


@lru_cache(maxsize=256)
def damping_ratio(restitution: float) -> float:
    """Return the damping ratio with which a push-only spring-damper has the given restitution.

    The bodies separate when the force, not the penetration, reaches zero (Schwager and Poeschel, Granular Matter 9,
    2007). A critically damped contact therefore still rebounds with a restitution of exp(-2). Lower restitutions cannot
    be reached, so the ratio is 1.
    """
    if restitution <= math.exp(-2):
        return 1.0
    low, high = 1e-3, 1.0
    for _ in range(60):  # bisection to the precision of a double
        middle = (low + high) / 2
        low, high = (middle, high) if rebound(middle) > restitution else (low, middle)
    return (low + high) / 2


def rebound(ratio: float) -> float:
    """Return the restitution of a push-only spring-damper whose damping ratio is below 1."""
    root = math.sqrt(1 - ratio * ratio)
    return math.exp(-ratio / root * math.atan2(2 * ratio * root, 2 * ratio * ratio - 1))


def contact_dimensions(surface: ContactSurface) -> int:
    """Return MuJoCo's ``condim`` for a contact, which depends on its resistance to spinning and rolling."""
    return 6 if surface.rolling else 4 if surface.spinning else 3


def unlike_groups(geoms: Iterable[ContactGeom]) -> list[UnlikeGroup]:
    """Return the groups of geoms that MuJoCo combines incorrectly, sorted by size with static groups first."""
    moving, static = (by_surface(geoms, static) for static in (False, True))
    found = [(static[a], moving[b]) for a, b in product(static, moving) if not is_native(a, b)]
    found += [(moving[a], moving[b]) for a, b in combinations(moving, 2) if not is_native(a, b)]
    found.sort(key=lambda pair: (not pair[0][0].static, len(pair[0]) * len(pair[1])))
    return [UnlikeGroup(one, other, desired_contact(one[0].surface, other[0].surface)) for one, other in found]


def by_surface(geoms: Iterable[ContactGeom], static: bool) -> dict[ContactSurface, list[ContactGeom]]:
    """Group either the static geoms or the movable geoms by surface."""
    groups: dict[ContactSurface, list[ContactGeom]] = {}
    for geom in geoms:
        if geom.static == static:
            groups.setdefault(geom.surface, []).append(geom)
    return groups


def group_pairs(group: UnlikeGroup, excluded: Excluded) -> Iterator[tuple[ContactGeom, ContactGeom]]:
    """Yield the pairs of geoms in a group that can collide."""
    for one, other in product(group.one, group.other):
        masked = not (one.contype & other.conaffinity or other.contype & one.conaffinity)
        if not masked and one.body != other.body and frozenset((one.body, other.body)) not in excluded:
            yield one, other


def written_groups(geoms: Sequence[ContactGeom]) -> tuple[list[UnlikeGroup], list[UnlikeGroup]]:
    """Return the groups whose pairs are written to :data:`CONTACTS_FILE`, followed by the groups that are too large."""
    kept, left, room = list[UnlikeGroup](), list[UnlikeGroup](), MAX_PAIRS
    for group in unlike_groups(geoms):
        count = len(group.one) * len(group.other)
        (kept if count <= room else left).append(group)
        room -= count if count <= room else 0
    return kept, left


def contacts_text(geoms: Sequence[ContactGeom], excluded: Excluded) -> str:
    """Return the text of :data:`CONTACTS_FILE`, in which each type of contact has a class with its pairs."""
    kept, left = written_groups(geoms)
    classes, lines, names = list[str](), list[str](), Counter[str]()
    for group in kept:
        pairs = list(group_pairs(group, excluded))
        if pairs:
            name = f"{group.one[0].material}:{group.other[0].material}"  # no class in scene.xml contains a colon
            names[name] += 1
            name += f":{names[name]}" if names[name] > 1 else ""
            pair = f"      <pair {_attributes(group.contact)} />"
            classes += [f'    <default class="{name}">', pair, "    </default>"]
            lines += [f'    <pair class="{name}" geom1="{a.name}" geom2="{b.name}" />' for a, b in pairs]
    if not lines and not left:
        return EMPTY
    about = [
        "Contacts between different materials, with the geometric mean of both frictions instead of the larger one.",
        "Generated from scene.xml; after you edit a friction there, run load.py with its `contacts` option.",
    ]
    if left:
        count = sum(len(group.one) * len(group.other) for group in left)
        about += [f"{count} more pairs of geoms are too many for a file; load.py makes their contacts exact in memory."]
    body = ["  <default>", *classes, "  </default>", "  <contact>", *lines, "  </contact>"]
    return "\n".join(["<mujoco>", *(f"  <!-- {line} -->" for line in about), *body, "</mujoco>", ""])


def pair_numbers(surface: ContactSurface) -> tuple[int, list[float], tuple[float, float] | None]:
    """Return the ``condim``, ``friction`` and ``solref`` of a pair, which are not inherited from its geoms."""
    mu, spinning, rolling = surface.friction, surface.spinning, surface.rolling
    damping = solref(surface.restitution) if surface.restitution > 0 else None
    return contact_dimensions(surface), [mu, mu, spinning, rolling, rolling], damping


def _attributes(surface: ContactSurface) -> str:
    dimensions, friction, damping = pair_numbers(surface)
    text = f'friction="{" ".join(map(format_number, friction))}"'
    text += f' condim="{dimensions}"' if dimensions != 3 else ""
    return text if damping is None else f'{text} solref="{" ".join(map(format_number, damping))}"'


def read_geoms(spec: mujoco.MjSpec) -> tuple[list[ContactGeom], dict[str, mujoco.MjsGeom], list[mujoco.MjsGeom]]:
    """Return the collision geoms of the scene, their counterparts in the specification, and the geoms of the robots.

    The counterparts are keyed by name. Geoms and bodies without a name get one that contains :data:`PROXY`.
    """
    robots = {name for text in spec.texts if text.name == ROBOTS for name in text.data.split()}
    ours: list[ContactGeom] = []
    by_name: dict[str, mujoco.MjsGeom] = {}
    foreign: list[mujoco.MjsGeom] = []
    pending = [(spec.worldbody, True, False)]
    while pending:
        body, static, foreign_body = pending.pop()
        for geom in body.geoms:
            if not (geom.contype or geom.conaffinity):
                continue
            if foreign_body:
                foreign.append(geom)
                continue
            body.name = body.name or f"{PROXY}_of_{len(by_name)}"  # masks and pairs refer to bodies and geoms by name
            geom.name = geom.name or f"{body.name}{PROXY}_of_{len(by_name)}"
            kind, masks = geom.classname.name, (geom.contype, geom.conaffinity)
            ours.append(ContactGeom(geom.name, body.name, static, _surface(geom), kind, *masks))
            by_name[geom.name] = geom
        pending += [(b, static and not b.joints, foreign_body or b.name in robots) for b in reversed(body.bodies)]
    return ours, by_name, foreign


def _surface(geom: mujoco.MjsGeom) -> ContactSurface:
    """Return the surface of a geom, excluding any spinning or rolling resistance disabled by its ``condim``."""
    sliding, spinning, rolling = (float(v) for v in geom.friction)
    restitution = float(geom.userdata[0]) if len(geom.userdata) else 0.0
    return ContactSurface(sliding, restitution, spinning * (geom.condim > 3), rolling * (geom.condim > 4))


def excluded_bodies(spec: mujoco.MjSpec) -> Excluded:
    """Return the pairs of bodies that MuJoCo does not collide.

    These pairs are excluded, welded together, or connected by a joint, unless one of them is static. MuJoCo does not
    apply these rules to explicit contact pairs.
    """
    static, welded = list[str](), list[tuple[list[str], list[str]]]()
    pending = [(body, static, static) for body in spec.worldbody.bodies]
    while pending:
        body, group, above = pending.pop()
        if body.joints:
            group, above = [], group
            welded.append((group, above))
        if group is not static:
            group.append(body.name)
        pending += [(child, group, above) for child in body.bodies]
    pairs = [(pair.bodyname1, pair.bodyname2) for pair in spec.excludes]
    pairs += [pair for group, above in welded for pair in product(group, group + above)]
    return frozenset(map(frozenset, pairs))


def make_exact(spec: mujoco.MjSpec) -> None:
    """Make all contacts in a scene exact by adding pairs or proxy geoms, based on the values in the specification.

    ``spec`` is the scene without :data:`CONTACTS_FILE`.
    """
    geoms, by_name, foreign = read_geoms(spec)
    excluded = excluded_bodies(spec)
    moving = sorted(by_surface(geoms, static=False).items(), key=lambda entry: -len(entry[1]))
    edited = any((geom.contype, geom.conaffinity) != (1, 1) for geom in geoms)  # proxies would overwrite these masks
    bits = [] if edited else _free_bits(foreign)
    bit_of = dict(zip((surface for surface, _ in moving), bits, strict=False))
    proxied: list[UnlikeGroup] = []
    for group in unlike_groups(geoms):
        if _needs_proxies(group, bit_of):
            proxied.append(group)
            continue
        for one, other in group_pairs(group, excluded):
            _add_pair(spec, one, other, group.contact)
    if proxied:
        _set_masks(geoms, by_name, bit_of, proxied)
        _exclude_proxies(spec, _add_proxies(by_name, bit_of, proxied))


def _free_bits(foreign: Iterable[mujoco.MjsGeom]) -> list[int]:
    """Return the mask bits that robots do not use.

    No bits are returned if a robot geom would not collide with the first bit alone.
    """
    used = 1
    for geom in foreign:
        used |= geom.contype | geom.conaffinity
        if geom.conaffinity & 1 and not geom.contype & 1:
            return []
    return [bit for bit in (1 << k for k in range(_MASK_BITS)) if not used & bit]


def _needs_proxies(group: UnlikeGroup, bit_of: Bits) -> bool:
    """Return true if a group is large and both of its surfaces have mask bits."""
    surfaces = [geoms[0].surface for geoms in (group.one, group.other) if not geoms[0].static]
    fewest = MIN_STATIC_PAIRS if group.one[0].static else MIN_MOVING_PAIRS
    return len(group.one) * len(group.other) >= fewest and all(surface in bit_of for surface in surfaces)


def _set_masks(
    geoms: Iterable[ContactGeom], by_name: Mapping[str, mujoco.MjsGeom], bit_of: Bits, proxied: Iterable[UnlikeGroup]
) -> None:
    """Set masks so that geoms collide with robots and with all surfaces in the scene that have no proxies.

    The affinity of a moving geom is the bit of its surface, and its type contains the bits of all surfaces with which
    the geom collides directly. A geom without a bit collides with everything; pairs override its incorrect contacts.
    """
    apart = {frozenset((group.one[0].surface, group.other[0].surface)) for group in proxied}
    types: dict[tuple[ContactSurface, bool], int] = {}
    for geom in geoms:
        key = (geom.surface, geom.static)
        if key not in types:
            met = [bit for other, bit in bit_of.items() if frozenset((geom.surface, other)) not in apart]
            types[key] = sum(met) | (0 if geom.static or geom.surface in bit_of else 1)
        mask = by_name[geom.name]
        mask.contype, mask.conaffinity = types[key], 1 if geom.static else 1 | bit_of.get(geom.surface, 0)


def _add_proxies(
    by_name: Mapping[str, mujoco.MjsGeom], bit_of: Bits, proxied: Iterable[UnlikeGroup]
) -> dict[str, list[str]]:
    """Add proxies for the geoms on the smaller side of each group, and return the proxy bodies' names by parent body.

    All surfaces that have the same contact properties share a proxy. Proxies have their own bodies, because MuJoCo
    skips whole bodies based on their masks.
    """
    masks: dict[tuple[str, ContactSurface], int] = {}
    for group in proxied:
        owners, met = (group.one, group.other)
        if not owners[0].static and len(met) < len(owners):
            owners, met = met, owners
        for geom in owners:
            masks[geom.name, group.contact] = masks.get((geom.name, group.contact), 0) | bit_of[met[0].surface]
    holders: dict[tuple[str, int], mujoco.MjsBody] = {}
    bodies: dict[str, list[str]] = {}
    for (name, contact), mask in masks.items():
        geom = by_name[name]
        body = geom.parent.name
        if (body, mask) not in holders:
            bodies.setdefault(body, []).append(f"{body}{PROXY}{mask}")
            holders[body, mask] = geom.parent.add_body(name=bodies[body][-1])
        _add_proxy(holders[body, mask], geom, f"{name}{PROXY}{mask}", contact, mask)
    return bodies


def _add_proxy(holder: mujoco.MjsBody, geom: mujoco.MjsGeom, name: str, contact: ContactSurface, mask: int) -> None:
    """Add a proxy with the shape of ``geom``, whose values take priority in all of its contacts."""
    dimensions, (mu, _, spinning, rolling, _), _ = pair_numbers(contact)
    values = {"condim": dimensions, "friction": [mu, spinning, rolling], "solref": [*solref(contact.restitution)]}
    values |= {"contype": mask, "conaffinity": 0, "priority": 1, "group": 4}
    holder.add_geom(geom.classname, name=name, **values, **{field: getattr(geom, field) for field in _SHAPE})


def _exclude_proxies(spec: mujoco.MjSpec, bodies: Mapping[str, list[str]]) -> None:
    """Apply the contact exclusions of each body to the proxy bodies that are fixed to it."""
    for pair in list(spec.excludes):
        a, b = pair.bodyname1, pair.bodyname2
        for one, other in [*((proxy, b) for proxy in bodies.get(a, ())), *((a, proxy) for proxy in bodies.get(b, ()))]:
            spec.add_exclude(bodyname1=one, bodyname2=other)


# The geom fields that a proxy copies: its shape, its pose and its contact parameters.
_SHAPE = ("type", "size", "pos", "quat", "fromto", "meshname", "hfieldname", "solimp", "margin", "gap")


def _add_pair(spec: mujoco.MjSpec, one: ContactGeom, other: ContactGeom, contact: ContactSurface) -> None:
    dimensions, friction, damping = pair_numbers(contact)
    pair = spec.add_pair(geomname1=one.name, geomname2=other.name, condim=dimensions, friction=friction)
    if damping is not None:
        pair.solref = [*damping]
