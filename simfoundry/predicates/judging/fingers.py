"""The fingers of a gripper, and a test that determines if they hold an object between them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from simfoundry.geometry.frames import Array, Poses
from simfoundry.predicates.judging.bodies import Bodies, CollisionBody, Entity
from simfoundry.predicates.judging.distances import FAR, Distances
from simfoundry.predicates.judging.thresholds import PRESS, TOUCH
from simfoundry.predicates.judging.view import StateBatch, View

if TYPE_CHECKING:
    from simfoundry.scene.robot import Gripper

# Minimum motion [m] for a link to count as a finger when the gripper closes.
STILL = 0.001


@dataclass(frozen=True, eq=False)
class Fingers:
    """The two sides of a gripper, represented as entities.

    ``axis`` is a unit vector in the frame of the ``base`` link. The first side closes along ``axis``, and the second
    side closes in the opposite direction.
    """

    sides: tuple[Entity, Entity]
    base: int
    axis: Array


def fingers(bodies: Bodies, name: str) -> Fingers | None:
    """Find a robot's fingers from the motion of its links when the gripper closes.

    Returns:
        The fingers, or None if the robot has no gripper.
    """
    from simfoundry.scene.robot import mujoco_model

    body = bodies[name]
    native = mujoco_model(bodies.scene.robot(name))
    if body.robot is None or native is None or native.gripper is None:
        return None
    opened, closed = (_links(bodies, body, native.gripper.positions(share)) for share in (0.0, 1.0))
    base = _carrier(body, native.gripper)
    X_BW = opened[base].inverse()
    moved = {}
    for k, form in enumerate(body.forms):
        if form is not None and form.solid:
            middle = form.ball[0]
            start, end = ((X_BW @ links[k]) for links in (opened, closed))
            way = (end.p + end.R @ middle - start.p - start.R @ middle)[0]
            if np.linalg.norm(way) > STILL:
                moved[k] = way
    if not moved:
        return None
    longest = max(moved.values(), key=lambda way: float(np.linalg.norm(way)))
    first = tuple(k for k, way in moved.items() if way @ longest > 0)
    second = tuple(k for k in moved if k not in first)
    ways = [np.mean([moved[k] for k in side], axis=0) if side else np.zeros(3) for side in (first, second)]
    closing = ways[0] - ways[1]  # motion that both sides share, such as extending, is not part of closing
    # A single jaw closes against the palm.
    sides = Entity(name, name, first, False), Entity(name, name, second or (base,), False)
    return Fingers(sides, base, closing / np.linalg.norm(closing))


def _links(bodies: Bodies, body: CollisionBody, positions: dict[str, float]) -> list[Poses]:
    """Return the poses of a robot's links at the given positions of its gripper's joints [rad or m]."""
    assert body.robot is not None
    at = {f"{body.name}.{body.robot.joints[joint]}": np.array([v]) for joint, v in positions.items()}
    view = View(bodies, StateBatch(1, {}, robots=at))
    return [view.link(body.name, k) for k in range(len(body.item.links))]


def _carrier(body: CollisionBody, gripper: Gripper) -> int:
    """Return the parent link of the gripper's first joint."""
    assert body.robot is not None
    first = body.robot.joints[next(iter(gripper.joints))]
    joint = next(j for j in body.item.joints if j.name == first)
    return body.index(joint.parent)


def grip_margin(view: View, distances: Distances, hands: Iterable[Fingers], thing: Entity) -> Array:
    """Return the margin [m] by which any of the hands holds an object, as an array of shape (n,).

    The margin is at least -:data:`FAR`, except in an exact view.
    """
    best = np.full(view.n, -np.inf if view.exact else -FAR)
    for hand in hands:
        margin = TOUCH - np.maximum(*(distances.between(view, side, thing, TOUCH) for side in hand.sides))
        near = np.flatnonzero(margin > 0)
        if len(near):
            margin[near] = np.minimum(margin[near], pressing(view.at(near), distances, hand, thing) - PRESS / 2)
        best = np.maximum(best, margin)
    return best


def pressing(view: View, distances: Distances, hand: Fingers, thing: Entity) -> Array:
    """Return how much closer [m] each side of a gripper gets to an object when it closes by :data:`PRESS`.

    Deeper penetration counts as getting closer. The result is the smaller of the values for the two sides, as an array
    of shape (n,). This value is small for a side that touches the object without holding it, because that side slides
    along the object.
    """
    X_WB = view.link(hand.sides[0].owner, hand.base)
    way = X_WB.R @ hand.axis
    least = np.full(view.n, np.inf)
    for side, sign in zip(hand.sides, (1.0, -1.0), strict=True):
        closer = distances.between(shifted(view, side, sign * PRESS * way), side, thing)
        least = np.minimum(least, distances.between(view, side, thing) - closer)
    return least


def shifted(view: View, thing: Entity, offset: Array) -> View:
    """Return the same states, except that the links of one entity are translated by ``offset`` [m].

    ``offset`` is an array of shape (n, 3).
    """
    other = view.at(np.arange(view.n))
    for k in thing.links:
        X_WL = view.link(thing.owner, k)
        other.place(thing.owner, k, Poses(X_WL.p + offset, X_WL.R))
    return other
