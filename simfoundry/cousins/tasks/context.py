"""The context of a task: the twin, the hands that act in it, and the directions from which they can reach objects.

An object is reached from above or, if it is covered, from an open side.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from simfoundry.cousins.layout.twin import Twin
from simfoundry.cousins.recipe.candidate import Reason
from simfoundry.geometry.frames import Array, Pose, quat_from_rpy
from simfoundry.geometry.grasp_width import grasp_width
from simfoundry.geometry.hulls import Hulls
from simfoundry.geometry.walls import free_distance
from simfoundry.robots.reach import Hand, hands_of, nearest_miss
from simfoundry.scene.frames import FrameTree
from simfoundry.scene.lengths import length
from simfoundry.scene.lower import lower
from simfoundry.scene.model import Joint
from simfoundry.scene.object_shapes import hulls, solid
from simfoundry.scene.state import SceneState, object_at
from simfoundry.spec.load import load_scene
from simfoundry.spec.models.scene import SceneSpec

if TYPE_CHECKING:
    from simfoundry.assets.cache import Cache

UP = np.array([0.0, 0.0, 1.0])

# Free distance required along the approach direction [m], enough for a hand and the wrist behind it (0.25 m for a
# Panda).
ROOM = 0.3

# Height by which an object is lifted on its way in or out [m]; more than a board's sag or the height of its lip.
LIFT = 0.01

# Length of the fingers beyond the hand [m]; the shortest known fingers, a Panda's, are 0.045 m long.
FINGERS = 0.04

# Half extents of a hand across and along the finger motion [m]; a Panda's hand is 63 mm thick and 204 mm wide.
HALF_THICK, HALF_WIDE = 0.035, 0.1

# Number of directions around an object, and the downward pitches of a side approach [rad]: horizontal, or inclined to
# clear the board under a low object.
TURNS, TILTS = 12, (0.0, math.radians(30.0))


@dataclass(frozen=True, eq=False)
class Approach:
    """The directions in which a hand approaches an object and leaves with it.

    The hand comes from ``side`` and leaves along ``way``. Both are unit vectors of shape (3,) that point away from the
    object.
    """

    side: Array
    way: Array

    @property
    def upright(self) -> Pose:
        """The rotation that turns this approach into an approach from above."""
        x, y, _ = self.side.tolist()
        lean = math.atan2(math.hypot(x, y), float(self.side[2]))
        turn = math.atan2(y, x)
        return Pose.of(q=quat_from_rpy(0.0, -lean, 0.0)) @ Pose.of(q=quat_from_rpy(0.0, 0.0, -turn))


ABOVE = Approach(UP, UP)


def approaches(setting: TaskContext, name: str, state: SceneState) -> tuple[Approach, ...]:
    """Return the possible approaches to an object in a given state.

    An object is approached from above or, if the space above it is blocked, from open sides. The result is empty if the
    object is enclosed.
    """
    low, high = setting.bounds(name, state)
    near = _obstacles(setting, {name, *setting.twin.riders(name)}, low, high, state)
    middle, half = (low + high) / 2, (high - low) / 2
    over = [np.array([middle[0] + a * half[0], middle[1] + b * half[1], high[2]]) for a, b in _CROSS]
    if _are_free(near, over, UP):
        return (ABOVE,)
    found = []
    for turn in np.arange(TURNS) * (2 * math.pi / TURNS):
        way = np.array([math.cos(turn), math.sin(turn), 0.0])
        if _are_free(near, _outline(low, high, way), way):
            sides = [math.cos(tilt) * way + math.sin(tilt) * UP for tilt in TILTS]
            free = (s for s in sides if _are_free(near, _back_of_hand(middle, half, s, way), s))
            found += [Approach(side, way) for side in islice(free, 1)]
    return tuple(found)


# The center of a top face and four points around it, as fractions of its half extents.
_CROSS = ((0.0, 0.0), (0.5, 0.0), (-0.5, 0.0), (0.0, 0.5), (0.0, -0.5))


def _outline(low: Array, high: Array, way: Array) -> list[Array]:
    """Return points [m] on a slightly raised box. These points are swept along a horizontal direction.

    They form a grid across the box, which contains the center of the box and its horizontal and vertical extremes.
    """
    middle, half = (low + high) / 2 + LIFT * UP, (high - low) / 2
    across = np.array([-way[1], way[0], 0.0])
    wide = float(np.abs(across) @ half)
    tall = half[2] * UP
    return [middle + a * wide * across + b * tall for a in (-1.0, 0.0, 1.0) for b in (-0.9, 0.0, 1.0)]


def _back_of_hand(middle: Array, half: Array, side: Array, way: Array) -> list[Array]:
    """Return the center and edge points [m] of the back of a hand that grasps a box from a side."""
    palm = middle + side * max(float(np.abs(side) @ half), FINGERS)
    across = np.array([-way[1], way[0], 0.0])
    thick = np.cross(side, across)
    return [palm + a * HALF_WIDE * across + b * HALF_THICK * thick for a in (-1.0, 0.0, 1.0) for b in (-1.0, 0.0, 1.0)]


def _obstacles(setting: TaskContext, own: set[str], low: Array, high: Array, state: SceneState) -> list[Hulls]:
    """Return the convex parts of other objects that are close enough to obstruct an approach."""
    twin, far = setting.twin, ROOM + HALF_WIDE
    others = [item for item in twin.scene.objects if item.name not in own | set(twin.absent)]
    moved = {item.name for item in others if setting.joints(item.name) and state.joints != twin.state.joints}
    shapes = [
        hulls(object_at(item, state)) if item.name in moved else twin.shape(item.name, state.poses[item.name])
        for item in others
    ]
    boxes = [(shape, *shape.bounds()) for shape in shapes if len(shape.corners)]
    return [shape for shape, least, most in boxes if (least < high + far).all() and (most > low - far).all()]


def _are_free(obstacles: Sequence[Hulls], points: Sequence[Array], way: Array) -> bool:
    return all(free_distance(shape, point, way) > ROOM for shape in obstacles for point in points)


# Tolerance [m] on the finger opening, because openings are specified in whole millimeters.
SLACK = 0.001


@dataclass(frozen=True, eq=False)
class TaskContext:
    """A twin and the hands that act in it.

    Attributes:
        twin: The twin.
        hands: Hands that can act in the scene.
        path: Path of the scene document, or None.
        kept: Cached results of :meth:`cannot_take` by object name.
        engines: Physics engines in which a goal state must remain stable. Trials always use MuJoCo.
    """

    twin: Twin
    hands: tuple[Hand, ...]
    path: Path | None = None
    kept: dict[str, tuple[Reason, ...]] = field(default_factory=dict, repr=False)
    engines: tuple[str, ...] = ("mujoco",)

    @classmethod
    def load(
        cls, path: Path, cache: Cache | None = None, payload: float | None = None, engines: Sequence[str] = ("mujoco",)
    ) -> TaskContext:
        """Load the context of a scene document.

        Args:
            path: Path of the scene document.
            cache: Cache for lowered objects.
            payload: Payload [kg] that overrides the known payload of each robot.
            engines: Physics engines in which a goal state must remain stable.

        Raises:
            SpecError: If the document is invalid.
            TwinError: If the scene does not come to rest.
        """
        loaded = load_scene(path)
        assert isinstance(loaded.spec, SceneSpec)
        return cls(
            Twin.of(lower(loaded, cache)),
            hands_of(loaded.spec.robots, FrameTree(loaded.spec), payload),
            path,
            engines=tuple(engines),
        )

    # -- object poses and joints ------------------------------------------------------------------------------------

    def bounds(self, name: str, state: SceneState | None = None) -> tuple[Array, Array]:
        """Return the minimum and maximum corners of the bounding box of an object or link in the world [m].

        A link is named ``object.link`` or ``object.joint``. The default ``state`` is the state of the twin.

        Returns:
            Two arrays of shape (3,).
        """
        owner, _, part = name.partition(".")
        state = state or self.twin.state
        item = self.twin.scene.object(owner)
        parts = self.twin.shape(owner, state.poses[owner])
        if part:
            moved = {joint.name: joint.child for joint in item.joints}
            number = [link.name for link in item.links].index(moved.get(part, part))
            parts = parts.of_link(number)
        return parts.bounds()

    def joints(self, argument: str) -> tuple[Joint, ...]:
        """Return the joints to which a name refers, provided that they have limits.

        The name has the form ``object``, ``object.joint`` or ``object.link``.
        """
        owner, _, part = argument.partition(".")
        limited = (j for j in self.twin.scene.object(owner).joints if j.has_axis and j.limits is not None)
        return tuple(j for j in limited if not part or part in (j.name, j.child))

    # -- feasible actions ---------------------------------------------------------------------------------------------

    def cannot_take(self, name: str) -> tuple[Reason, ...]:
        """Return the reasons why no hand can pick up an object at its current pose.

        The result is empty if a hand can pick it up.
        """
        if name not in self.kept:
            self.kept[name] = tuple(self._taken(name))
        return self.kept[name]

    def _taken(self, name: str) -> list[Reason]:
        item = self.twin.scene.object(name)
        if item.fixed:
            return [Reason("fixed", f"`{name}` is fixed in the scene, so it cannot be moved")]
        found = []
        mass = sum(link.mass for link in item.links)
        if self.hands and mass > (most := max(hand.payload for hand in self.hands)):
            text = f"`{name}` weighs {mass:.2f} kg, but the robot can only lift {most:g} kg"
            found.append(Reason("too_heavy", text, {"mass_kg": mass, "payload_kg": most}))
        drawers = any(self.joints(below) for below in self.twin.carried.get(name, ()))
        # Objects in a drawer are picked up after it is opened, so obstacles that are above them now do not matter.
        return found + list(self.cannot_hold(name, self.twin.state, (ABOVE,) if drawers else None))

    def cannot_hold(self, name: str, state: SceneState, ways: tuple[Approach, ...] | None = None) -> tuple[Reason, ...]:
        """Return the reasons why no hand can hold an object in a given state.

        The result is empty if a hand can hold it. ``ways`` contains the approaches to consider. By default, these are
        all free approaches.
        """
        if not self.hands:
            return ()
        ways = approaches(self, name, state) if ways is None else ways
        if not ways:
            return (Reason("covered", f"no hand can reach `{name}`, because it is covered and enclosed on all sides"),)
        found: tuple[Reason, ...] = ()
        bounds = self.bounds(name, state)
        for way in ways:
            # The grasp from above has already been tested at the pick-up pose.
            known = way is ABOVE and state is not self.twin.state
            lacks = (*(() if known else self._too_wide(name, state, way)), *self.cannot_reach(name, *bounds, way))
            if not lacks:
                return ()
            found = found or lacks
        return found

    def _too_wide(self, name: str, state: SceneState, way: Approach) -> tuple[Reason, ...]:
        openings = [hand.opening for hand in self.hands if hand.opening is not None]
        if not openings or len(openings) < len(self.hands):
            return ()
        X_WO = state.poses[name] if way is ABOVE else Pose.of(q=(way.upright @ state.poses[name]).q)
        width, widest = grasp_width(solid(self.twin.item_at(name, X_WO))), max(openings)
        if width <= widest + SLACK:
            return ()
        narrow = f"is {length(width)} wide at its narrowest" if math.isfinite(width) else "cannot be grasped"
        text = f"`{name}` {narrow}, but the fingers only open to {length(widest)}"
        return (Reason("too_wide", text, {"width_m": min(width, 1e3), "opening_m": widest}),)

    def cannot_reach(self, name: str, low: Array, high: Array, approach: Approach = ABOVE) -> tuple[Reason, ...]:
        """Return the reasons why no hand can reach an object. The result is empty if a hand can reach it.

        Inverse kinematics is used if available.

        Args:
            name: Name of the object.
            low: Minimum corner of its bounding box in the world [m], shape (3,).
            high: Maximum corner of its bounding box in the world [m], shape (3,).
            approach: Approach of the hand.
        """
        if lacks := self.too_far(name, low, high):
            return lacks
        solved = self.twin.robots.reach(low, high, approach.side.tolist(), approach.way.tolist())
        if solved.checked and not solved.reached:
            comes = "from above" if approach is ABOVE else "from an open side"
            text = f"no arm can reach `{name}` {comes}: it is {solved.away:.2f} m from the base of `{solved.robot}`"
            return (Reason("out_of_reach", text, {"away_m": solved.away}),)
        return ()

    def too_far(self, name: str, low: Array, high: Array) -> tuple[Reason, ...]:
        """Return a reason if a bounding box with the given corners in the world [m] is out of reach of all hands."""
        middle = ((low + high) / 2)[:2].tolist()
        miss = nearest_miss(self.hands, [math.dist(middle, hand.at) for hand in self.hands]) if self.hands else None
        if miss is None:
            return ()
        text = f"`{name}` is {miss.distance:.2f} m from `{miss.hand.name}`, which reaches {miss.reach:g} m"
        return (Reason("out_of_reach", text, {"away_m": miss.distance, "reach_m": miss.reach}),)
