"""``At(a, x, y[, z])``: the frame of ``a`` is at a point in the world."""

from __future__ import annotations

from typing import TYPE_CHECKING

from simfoundry.spec.models.predicate import Effect, Predicate

if TYPE_CHECKING:
    from simfoundry.predicates.judging.bodies import Entity
    from simfoundry.predicates.judging.terms import Terms

AT = 0.02
"""Largest distance [m] from the point: about half the width of an object that a gripper can grasp."""


def at(terms: Terms, a: Entity, *point: float) -> None:
    """Require that the frame of ``a`` is near ``point`` [m], with two or three world coordinates."""
    import numpy as np

    from simfoundry.scene.lengths import length

    off = np.linalg.norm(terms.view.frame(a).p[:, : len(point)] - np.array(point), axis=1)
    terms.require(off, AT - off, lambda v, ok: f"`{a.name}` is {length(v)} from the point")


PREDICATE = Predicate(
    "At",
    "the object is at x, y and, if given, z in the world [m]",
    ("thing", "number", "number", "number"),
    at,
    f"the origin of `a` is at most {AT * 100:g} cm from the point; without z, in the horizontal plane",
    optional=1,
    effect=Effect.MOVE,
)
