"""``LeftOf``, ``RightOf``, ``InFrontOf`` and ``Behind``, as seen from the scene's viewpoint."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from simfoundry.spec.models.predicate import Effect, Predicate

if TYPE_CHECKING:
    from simfoundry.geometry.frames import Array, Pose
    from simfoundry.predicates.judging.bodies import Entity
    from simfoundry.predicates.judging.terms import Terms

AXES = {"LeftOf": (1, 1.0), "RightOf": (1, -1.0), "Behind": (0, 1.0), "InFrontOf": (0, -1.0)}
"""Axis of the viewer's frame (0 away, 1 left) and the sign along it."""


def viewer_axis(viewer: Pose | None, column: int) -> Array:
    """Horizontal unit vector away from the viewer (0) or to its left (1), shape (3,)."""
    import numpy as np

    x, y = (1.0, 0.0) if viewer is None else viewer.rotation[:2, 0]
    size = float(np.hypot(x, y))
    away = np.array([1.0, 0.0, 0.0]) if size < LEVEL else np.array([x, y, 0.0]) / size
    return away if column == 0 else np.cross([0.0, 0.0, 1.0], away)


LEVEL = 1e-6
"""Length of the horizontal part of a unit vector below which the viewer looks straight up or down."""


def _beside(name: str, words: str, terms: Terms, a: Entity, b: Entity) -> None:
    """Require that the middle of each object is beyond the other's edge along the axis of ``name``."""
    import numpy as np

    from simfoundry.scene.lengths import length

    column, sign = AXES[name]
    axis = sign * viewer_axis(terms.context.bodies.scene.viewer, column)
    (low_a, high_a), (low_b, high_b) = terms.view.span(a, axis), terms.view.span(b, axis)
    off = (low_a + high_a - low_b - high_b) / 2
    half = np.maximum(high_a - low_a, high_b - low_b) / 2

    def text(v: float, ok: bool) -> str:
        if ok:
            return f"`{a.name}` is {words} `{b.name}`: each middle is {length(v)} or more beyond the other's edge"
        return f"`{a.name}` is not {words} `{b.name}`: their middles are {length(-v)} short of being side by side"

    terms.require(off - half, off - half, text)


def _side(name: str, alias: str, meaning: str) -> Predicate:
    return Predicate(
        name,
        meaning,
        ("thing", "thing"),
        partial(_beside, name, alias.replace("_", " ")),
        "in the named direction, as seen from the viewpoint, the middle of `a` is beyond all of `b`, and all of `a` is "
        "beyond the middle of `b`",
        effect=Effect.MOVE,
        aliases=(alias,),
    )


LEFT_OF = _side("LeftOf", "left_of", "the first is left of the second, seen from the viewpoint")
RIGHT_OF = _side("RightOf", "right_of", "the first is right of the second, seen from the viewpoint")
IN_FRONT_OF = _side("InFrontOf", "in_front_of", "the first is nearer to the viewpoint than the second")
BEHIND = _side("Behind", "behind", "the first is farther from the viewpoint than the second")
