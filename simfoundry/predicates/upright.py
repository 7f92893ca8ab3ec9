"""``Upright(a)``: the z axis of ``a`` points up."""

from __future__ import annotations

from typing import TYPE_CHECKING

from simfoundry.spec.models.predicate import Predicate

if TYPE_CHECKING:
    from simfoundry.predicates.judging.bodies import Entity
    from simfoundry.predicates.judging.terms import Terms

UPRIGHT_DEG = 10.0
"""Largest tilt [deg]: standing objects tilt less after settling, fallen objects far more."""


def upright(terms: Terms, a: Entity) -> None:
    """Require that the angle between the z axis of ``a`` and up is at most :data:`UPRIGHT_DEG`."""
    import numpy as np

    z = terms.view.frame(a).R[:, :, 2]
    lean = np.degrees(np.arctan2(np.hypot(z[:, 0], z[:, 1]), z[:, 2]))
    terms.require(lean, UPRIGHT_DEG - lean, lambda v, ok: f"`{a.name}` leans by {v:.1f} deg")


PREDICATE = Predicate(
    "Upright",
    "its z axis points up",
    ("thing",),
    upright,
    f"the z axis of `a` is at most {UPRIGHT_DEG:g} deg from vertical",
    unit="deg",
    aliases=("upright",),
)
