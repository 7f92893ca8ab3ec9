"""Contacts in a MuJoCo model and their friction, computed with MuJoCo's rules for masks and priorities."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations
from typing import NamedTuple

import mujoco
import numpy as np

PROXY = ":proxy"
"""The suffix that a proxy body or geom adds to the name of its link or collider."""


class ContactFriction(NamedTuple):
    """The friction of a contact, and its resistance to spinning and rolling [m]."""

    friction: float
    spinning: float
    rolling: float


Form = tuple[int, int, int, int, ContactFriction]
"""The two masks, the priority, the contact dimensions and the friction of a geom."""

AMBIGUOUS = ContactFriction(float("inf"), float("inf"), float("inf"))
"""The resistance reported for two colliders if several pairs of their geoms collide, which is an error."""


class Meetings:
    """The collision geoms of a model, grouped by body and collider.

    ``colliders`` lists the geoms and the proxies of each collider.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self.model = model
        self.colliders: dict[int, dict[str, list[int]]] = {}
        for geom in np.flatnonzero((model.geom_contype != 0) | (model.geom_conaffinity != 0)).tolist():
            body = int(model.geom_bodyid[geom])
            link = int(model.body_parentid[body]) if PROXY in model.body(body).name else body
            collider = model.geom(geom).name.partition(PROXY)[0] or f"#{geom}"
            self.colliders.setdefault(link, {}).setdefault(collider, []).append(geom)
        self._excluded = {int(k) for k in model.exclude_signature}
        pairs = zip(model.pair_geom1.tolist(), model.pair_geom2.tolist(), strict=True)
        slides = zip(model.pair_friction[:, [0, 2, 3]].tolist(), model.pair_dim.tolist(), strict=True)
        self._explicit = {frozenset(pair): resistance(row, dim) for pair, (row, dim) in zip(pairs, slides, strict=True)}
        self._weld = [int(k) for k in model.body_weldid]
        self._above = [self._weld[int(model.body_parentid[w])] for w in self._weld]
        columns = (model.geom_contype, model.geom_conaffinity, model.geom_priority, model.geom_condim)
        rows = zip(*(column.tolist() for column in columns), strict=True)
        frictions = (ContactFriction(*row) for row in model.geom_friction.tolist())
        self._forms: list[Form] = [(*row, friction) for row, friction in zip(rows, frictions, strict=True)]

    def contact(self, a: list[int], b: list[int]) -> ContactFriction | None:
        """Return the resistance between two colliders, or None if they never collide.

        Each collider is given by its geoms.
        """
        found = [met for one in a for other in b if (met := self._meet(one, other)) is not None]
        return None if not found else found[0] if len(found) == 1 else AMBIGUOUS

    def surface(self, geom: int) -> ContactFriction:
        """Return a geom's own resistance."""
        return resistance(self._forms[geom][4], self._forms[geom][3])

    def touch(self, a: int, b: int) -> bool:
        """Return true if any geoms of two bodies collide."""
        ours, theirs = self.colliders.get(a, {}), self.colliders.get(b, {})
        return any(self.contact(one, other) is not None for one in ours.values() for other in theirs.values())

    def contacts(self) -> Iterator[tuple[str, str, ContactFriction]]:
        """Yield all pairs of named colliders in different bodies that can collide, with their resistance."""
        for a, b in combinations(sorted(self.colliders), 2):
            for one, ours in self.colliders[a].items():
                for other, theirs in self.colliders[b].items():
                    met = None if "#" in (one[0], other[0]) else self.contact(ours, theirs)
                    if met is not None:
                        yield one, other, met

    def _meet(self, a: int, b: int) -> ContactFriction | None:
        explicit = self._explicit.get(frozenset((a, b))) if self._explicit else None
        if explicit is not None:
            return explicit
        type_a, affinity_a, priority_a, dim_a, slide_a = self._forms[a]
        type_b, affinity_b, priority_b, dim_b, slide_b = self._forms[b]
        if not (type_a & affinity_b or type_b & affinity_a):
            return None
        if self._apart(int(self.model.geom_bodyid[a]), int(self.model.geom_bodyid[b])):
            return None
        if priority_a == priority_b:
            return resistance([max(values) for values in zip(slide_a, slide_b, strict=True)], max(dim_a, dim_b))
        return resistance(slide_a, dim_a) if priority_a > priority_b else resistance(slide_b, dim_b)

    def _apart(self, a: int, b: int) -> bool:
        """Return true if two bodies never collide because they are excluded, welded or connected by a joint.

        Joints to the world do not prevent collisions.
        """
        a, b = min(a, b), max(a, b)
        one, two = self._weld[a], self._weld[b]
        joined = bool(one and two) and (one == self._above[b] or two == self._above[a])
        return one == two or joined or (a << 16) + b in self._excluded


def resistance(friction: Sequence[float], dimensions: int) -> ContactFriction:
    """Return the resistance from MuJoCo's three coefficients, ignoring those that do not apply to ``dimensions``."""
    sliding, spinning, rolling = friction
    return ContactFriction(sliding, spinning if dimensions > 3 else 0.0, rolling if dimensions > 4 else 0.0)
