"""``At(a, x, y[, z])``: the frame of ``a`` is at that point of the world."""

from __future__ import annotations

from typing import TYPE_CHECKING

from simfoundry.spec.models.predicate import Effect, Predicate

if TYPE_CHECKING:
    from simfoundry.predicates.judging.bodies import Entity
    from simfoundry.predicates.judging.terms import Terms

AT = 0.02
"""Greatest distance [m] from the point: about half of the width of what a gripper takes."""


def at(terms: Terms, a: Entity, *point: float) -> None:
    """Require that the frame of ``a`` is near ``point`` [m], two or three coordinates in the world."""
    import numpy as np

    from simfoundry.scene.lengths import length

    off = np.linalg.norm(terms.view.frame(a).p[:, : len(point)] - np.array(point), axis=1)
    terms.require(off, AT - off, lambda v, ok: f"`{a.name}` is {length(v)} from there")


PREDICATE = Predicate(
    "At",
    "the thing is at x, y and perhaps z of the world [m]",
    ("thing", "number", "number", "number"),
    at,
    f"the origin of `a` is at most {AT * 100:g} cm from the point; without z, in the horizontal plane",
    optional=1,
    effect=Effect.MOVE,
)
