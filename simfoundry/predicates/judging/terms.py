"""Terms of a predicate: measured values with signed margins, all of which must be positive."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import NamedTuple

import numpy as np

from simfoundry.geometry.frames import Array
from simfoundry.predicates.judging.bodies import Bodies, Entity
from simfoundry.predicates.judging.distances import Distances
from simfoundry.predicates.judging.fingers import Fingers, fingers, grip_margin
from simfoundry.predicates.judging.states import StateBatch
from simfoundry.predicates.judging.thresholds import SETTLED
from simfoundry.predicates.judging.view import View
from simfoundry.scene.lengths import length

Explain = Callable[[float, bool], str]
"""Function from a term's value, and whether the term holds, to its explanation, which may be empty."""


class Context:
    """Measurements prepared once for a scene."""

    def __init__(self, bodies: Bodies, bounds_first: bool = False) -> None:
        self.bodies = bodies
        self.distances = Distances(bodies, bounds_first)

    @cached_property
    def hands(self) -> dict[str, Fingers]:
        """Fingers of the robots with a gripper, by robot."""
        found = {name: fingers(self.bodies, name) for name in self.bodies.robots}
        return {name: hand for name, hand in found.items() if hand is not None}

    @cached_property
    def start(self) -> View:
        """Initial state of the scene as a batch of one."""
        return View(self.bodies, StateBatch(1, {}))

    def others(self, *things: Entity) -> list[Entity]:
        """Objects with a shape to which none of ``things`` belongs."""
        owners = {thing.owner for thing in things}
        names = (name for name in self.bodies.objects if name not in owners)
        return [self.bodies.thing(name) for name in names if any(self.bodies[name].forms)]


class Term(NamedTuple):
    """One decisive quantity: its ``value`` and ``margin``, (n,); NaN if an earlier term was decisive."""

    value: Array
    margin: Array
    explain: Explain

    def text(self, k: int) -> str:
        """Return the explanation for the k-th state."""
        return self.explain(float(self.value[k]), bool(self.margin[k] > 0))


class Terms:
    """Terms of one predicate in the states of ``view``, in the order in which its rule adds them."""

    def __init__(self, context: Context, view: View) -> None:
        self.context, self.view = context, view
        self.terms: list[Term] = []
        self.margin: Array = np.full(view.n, np.inf)

    def require(self, value: Array, margin: Array, explain: Explain) -> None:
        """Add a term that is known in every state."""
        self.terms.append(Term(value, margin, explain))
        self.margin = np.minimum(self.margin, margin)

    def require_if_open(
        self, measure: Callable[[View], Array], margin: Callable[[Array], Array], explain: Explain
    ) -> None:
        """Add a term that is slow to measure, only in the states in which every term so far holds.

        ``measure`` returns the values in these states, and ``margin`` converts values to margins.
        """
        value, margins = np.full(self.view.n, np.nan), np.full(self.view.n, np.nan)
        left = np.flatnonzero(self.margin > 0)
        if len(left):
            value[left] = measure(self.view if len(left) == self.view.n else self.view.at(left))
            margins[left] = margin(value[left])
            self.margin[left] = np.minimum(self.margin[left], margins[left])
        self.terms.append(Term(value, margins, explain))

    def require_at_rest(self, a: Entity) -> None:
        """Require that the object of ``a`` moves no faster than :data:`SETTLED`."""
        speed = self.view.batch.speeds.get(a.owner, np.zeros(self.view.n))
        self.require(speed, SETTLED - speed, lambda v, ok: "" if ok else f"`{a.name}` moves at {100 * v:.1f} cm/s")

    def require_not_held(self, a: Entity) -> None:
        """Require that no gripper holds ``a``."""
        if self.context.bodies.robots:
            self.require_if_open(
                lambda view: grip_margin(view, self.context.distances, self.context.hands.values(), a),
                lambda v: -v,
                lambda v, ok: "" if ok else f"a robot holds `{a.name}`",
            )

    def gap_text(self, a: Entity, b: Entity, value: float) -> str:
        """Explain a distance [m] between two entities."""
        if not np.isfinite(value):
            return f"`{a.name}` or `{b.name}` has no colliders"
        return f"`{a.name}` is {length(value)} away from `{b.name}`" if value > 0 else f"`{a.name}` touches `{b.name}`"

    def explanation(self, k: int) -> str:
        """Return the terms that fail in the k-th state, or all of them if none does."""
        known = [term for term in self.terms if not np.isnan(term.margin[k])]
        failed = [term for term in known if not term.margin[k] > 0]
        return "; ".join(text for term in failed or known if (text := term.text(k)))
