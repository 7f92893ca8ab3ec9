"""Which geoms of a MuJoCo model meet, and with which friction, by MuJoCo's own rules for masks and priorities."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

import mujoco
import numpy as np

TWIN = ":touch"
"""How the name of a body or geom goes on after that of the link or collider that it is a part of."""

Form = tuple[int, int, int, float]
"""Masks, priority and friction of a geom."""


class Meetings:
    """The geoms that touch, by body and collider; ``colliders`` gives each collider's geoms, those of its twins too."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self.model = model
        self.colliders: dict[int, dict[str, list[int]]] = {}
        names = [model.body(k).name for k in range(model.nbody)]
        for geom in np.flatnonzero((model.geom_contype != 0) | (model.geom_conaffinity != 0)).tolist():
            body = int(model.geom_bodyid[geom])
            link = int(model.body_parentid[body]) if TWIN in names[body] else body
            collider = model.geom(geom).name.partition(TWIN)[0] or f"#{geom}"
            self.colliders.setdefault(link, {}).setdefault(collider, []).append(geom)
        self._excluded = {int(k) for k in model.exclude_signature}
        frictions = (float(row[0]) for row in model.pair_friction)
        pairs = zip(model.pair_geom1, model.pair_geom2, strict=True)
        self._explicit = {frozenset((int(a), int(b))): mu for (a, b), mu in zip(pairs, frictions, strict=True)}
        self._weld = [int(k) for k in model.body_weldid]
        self._above = [self._weld[int(model.body_parentid[w])] for w in self._weld]
        columns = (model.geom_contype, model.geom_conaffinity, model.geom_priority, model.geom_friction[:, 0])
        self._forms: list[Form] = list(zip(*(column.tolist() for column in columns), strict=True))

    def friction(self, a: list[int], b: list[int]) -> float | None:
        """The sliding friction of two colliders by their geoms; None where they never meet, infinite where twice."""
        found = [mu for one in a for other in b if (mu := self._meet(one, other)) is not None]
        return None if not found else found[0] if len(found) == 1 else float("inf")

    def touch(self, a: int, b: int) -> bool:
        """Whether any colliders of two bodies meet."""
        ours, theirs = self.colliders.get(a, {}), self.colliders.get(b, {})
        return any(self.friction(one, other) is not None for one in ours.values() for other in theirs.values())

    def frictions(self) -> Iterator[tuple[str, str, float]]:
        """Every two named colliders of different bodies that meet, with their friction."""
        for a, b in combinations(sorted(self.colliders), 2):
            for one, ours in self.colliders[a].items():
                for other, theirs in self.colliders[b].items():
                    mu = None if "#" in (one[0], other[0]) else self.friction(ours, theirs)
                    if mu is not None:
                        yield one, other, mu

    def _meet(self, a: int, b: int) -> float | None:
        explicit = self._explicit.get(frozenset((a, b))) if self._explicit else None
        if explicit is not None:
            return explicit
        (type_a, affinity_a, priority_a, mu_a), (type_b, affinity_b, priority_b, mu_b) = self._forms[a], self._forms[b]
        if not (type_a & affinity_b or type_b & affinity_a):
            return None
        if self._apart(int(self.model.geom_bodyid[a]), int(self.model.geom_bodyid[b])):
            return None
        if priority_a == priority_b:
            return max(mu_a, mu_b)
        return mu_a if priority_a > priority_b else mu_b

    def _apart(self, a: int, b: int) -> bool:
        """Whether two bodies never meet: excluded, welded to each other, or joined; what is in the world joins none."""
        a, b = min(a, b), max(a, b)
        one, two = self._weld[a], self._weld[b]
        joined = bool(one and two) and (one == self._above[b] or two == self._above[a])
        return one == two or joined or (a << 16) + b in self._excluded
