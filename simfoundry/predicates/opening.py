"""``Open(joint)`` and ``Closed(joint)``, by the share of the joint's range; an object stands for its limited joints."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from simfoundry.spec.models.predicate import Effect, Predicate

if TYPE_CHECKING:
    from simfoundry.predicates.judging.bodies import Joints
    from simfoundry.predicates.judging.terms import Terms

OPEN_SHARE = 0.10
"""Share of a joint's range from its closed end beyond which it counts as open (OmniGibson's rule)."""


def _opening(closed: bool, terms: Terms, joints: Joints) -> None:
    """Require that each joint is open by more than :data:`OPEN_SHARE`, or by no more than that if ``closed``."""
    import numpy as np

    for joint in joints.joints:
        assert joint.limits is not None
        reach = joint.limits[1] - joint.limits[0]
        share = np.abs(terms.view.position(joints.owner, joint) - joint.closed_position) / reach
        margin = (share - OPEN_SHARE) * reach
        if closed:
            margin = np.where(margin == 0, np.nextafter(0.0, 1.0), -margin)  # the threshold itself counts as closed
        name = f"{joints.owner}.{joint.name}"
        terms.require(share, margin, lambda v, ok, name=name: f"`{name}` is open by {v:.1%} of its range")  # type: ignore[misc]


OPEN = Predicate(
    "Open",
    "the joint, or every joint of the object, is open",
    ("joint",),
    partial(_opening, False),
    f"the joint is more than {OPEN_SHARE:.0%} of its range away from its closed end; for an object, every joint that "
    "has limits. The closed end is the limit that the joint's key `closed` names, or else zero, or the limit that is "
    "closest to zero",
    unit="m or rad",
    effect=Effect.JOINT,
    aliases=("open",),
)
CLOSED = Predicate(
    "Closed",
    "the joint, or every joint of the object, is closed",
    ("joint",),
    partial(_opening, True),
    f"the joint is at most {OPEN_SHARE:.0%} of its range away from its closed end; for an object, every joint that "
    "has limits",
    unit="m or rad",
    effect=Effect.JOINT,
    aliases=("closed", "Close"),
)
