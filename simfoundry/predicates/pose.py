"""The predicates ``At``, ``Upright``, ``Open`` and ``Closed``, which describe an object's pose or joint positions."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from simfoundry.scene.lengths import length
from simfoundry.spec.models.predicate import Effect, Predicate

if TYPE_CHECKING:
    from simfoundry.predicates.judging.bodies import Entity, Joints
    from simfoundry.predicates.judging.judge import Terms

# Maximum distance [m] from the point, which is about half the width of an object that a gripper can grasp.
AT_DISTANCE = 0.02


def at(terms: Terms, a: Entity, *point: float) -> None:
    """Require that the origin of ``a`` is close to ``point``, which consists of two or three world coordinates [m]."""
    import numpy as np

    off = np.linalg.norm(terms.view.frame(a).p[:, : len(point)] - np.array(point), axis=1)
    terms.require(off, AT_DISTANCE - off, lambda v, ok: f"`{a.name}` is {length(v)} from the point")


AT = Predicate(
    "At",
    "the object is at the world coordinates x, y and, optionally, z [m]",
    ("thing", "number", "number", "number"),
    at,
    f"the origin of `a` is at most {AT_DISTANCE * 100:g} cm from the point; without z, the distance is horizontal",
    optional=1,
    effect=Effect.MOVE,
)


# Maximum tilt [deg]; after settling, upright objects tilt less than this, and fallen objects far more.
UPRIGHT_DEG = 10.0


def upright(terms: Terms, a: Entity) -> None:
    """Require that the angle between the z axis of ``a`` and the vertical is at most :data:`UPRIGHT_DEG`."""
    import numpy as np

    z = terms.view.frame(a).R[:, :, 2]
    lean = np.degrees(np.arctan2(np.hypot(z[:, 0], z[:, 1]), z[:, 2]))
    terms.require(lean, UPRIGHT_DEG - lean, lambda v, ok: f"`{a.name}` leans by {v:.1f} deg")


UPRIGHT = Predicate(
    "Upright",
    "the object's z axis points up",
    ("thing",),
    upright,
    f"the z axis of `a` is at most {UPRIGHT_DEG:g} deg from vertical",
    unit="deg",
    aliases=("upright",),
)


# Fraction of a joint's range, measured from the closed end, beyond which the joint counts as open (as in OmniGibson).
OPEN_SHARE = 0.10


def _opening(closed: bool, terms: Terms, joints: Joints) -> None:
    """Require that each joint is open by more than the share :data:`OPEN_SHARE` of its range.

    If ``closed`` is set, require that each joint is open by at most this share.
    """
    import numpy as np

    for joint in joints.joints:
        assert joint.limits is not None
        reach = joint.limits[1] - joint.limits[0]
        share = np.abs(terms.view.position(joints.owner, joint) - joint.closed_position) / reach
        margin = (share - OPEN_SHARE) * reach
        if closed:
            margin = np.where(margin == 0, np.nextafter(0.0, 1.0), -margin)  # the threshold itself counts as closed
        name = f"{joints.owner}.{joint.name}"
        # Half of the range, so that drawers and doors have the same scores.
        terms.require(share, margin, lambda v, ok, name=name: f"`{name}` is open by {v:.1%} of its range", reach / 2)  # type: ignore[misc]


OPEN = Predicate(
    "Open",
    "the joint, or every joint of the object, is open",
    ("joint",),
    partial(_opening, False),
    f"the joint is more than {OPEN_SHARE:.0%} of its range away from its closed end; for an object, this applies to "
    "every joint that has limits. The closed end is the limit specified by the joint's `closed` key or, if the key is "
    "not set, the position within the limits that is closest to zero",
    unit="m or rad",
    effect=Effect.JOINT,
    aliases=("open",),
)
CLOSED = replace(
    OPEN,
    name="Closed",
    meaning="the joint, or every joint of the object, is closed",
    rule=partial(_opening, True),
    definition=f"the joint is at most {OPEN_SHARE:.0%} of its range away from its closed end; for an object, this "
    "applies to every joint that has limits",
    aliases=("closed", "Close"),
)
