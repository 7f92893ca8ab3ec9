"""Many states of the bodies in a scene, stored as arrays. Poses, bounding boxes and extents are computed on demand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from simfoundry.geometry.form import TURNED, Form
from simfoundry.geometry.frames import Array, Index, Pose, Poses, rotate
from simfoundry.predicates.judging.bodies import Bodies, Entity
from simfoundry.scene.model import Joint, JointType, Scene
from simfoundry.scene.state import SceneState


@dataclass(frozen=True, eq=False)
class StateBatch:
    """A batch of ``n`` states of one scene.

    Missing values default to those of the scene at rest.

    Attributes:
        n: The number of states.
        poses: The poses X_WO, keyed by object.
        joints: The joint positions [rad or m], shape (n,) each, keyed by ``object.joint``.
        motions: The motions of ball and free joints, as in :class:`SceneState`.
        robots: The positions of robot joints [rad or m], shape (n,) each, keyed by ``robot.joint``.
        speeds: The speeds [m/s], shape (n,) each, keyed by object.
    """

    n: int
    poses: Mapping[str, Poses]
    joints: Mapping[str, Array] = field(default_factory=dict)
    motions: Mapping[str, Poses] = field(default_factory=dict)
    robots: Mapping[str, Array] = field(default_factory=dict)
    speeds: Mapping[str, Array] = field(default_factory=dict)

    @classmethod
    def of(cls, scene: Scene, states: Sequence[SceneState]) -> StateBatch:
        """Combine states in the given order. Values that are missing in a state are taken from the scene."""
        initial = SceneState.initial(scene)
        arms = {f"{r}.{j}": (r, j) for s in states for r, joints in s.robots.items() for j in joints}
        if any(r not in s.robots for r in (states[0].robots if states else ()) for s in states):
            raise ValueError("only some states contain robot joint positions; provide them for all states or for none")
        moving = {name for s in states for name in s.speeds}
        return cls(
            len(states),
            _stacked({n: [s.poses.get(n, pose) for s in states] for n, pose in initial.poses.items()}),
            {n: np.array([s.joints.get(n, at) for s in states]) for n, at in initial.joints.items()},
            _stacked({n: [s.motions.get(n, at) for s in states] for n, at in initial.motions.items()}),
            {n: np.array([s.robots[r][j] for s in states]) for n, (r, j) in sorted(arms.items())},
            {n: np.array([s.speeds.get(n, 0.0) for s in states]) for n in sorted(moving)},
        )

    def at(self, index: Index) -> StateBatch:
        """Return a batch with the selected states."""
        poses, motions = ({n: x.at(index) for n, x in m.items()} for m in (self.poses, self.motions))
        values = (self.joints, self.robots, self.speeds)
        joints, robots, speeds = ({n: x[index] for n, x in m.items()} for m in values)
        return StateBatch(len(index), poses, joints, motions, robots, speeds)


def _stacked(poses: Mapping[str, Sequence[Pose]]) -> dict[str, Poses]:
    """Convert the poses of all objects in n states at once, which is hardly slower than converting a single pose."""
    every = [pose for each in poses.values() for pose in each]
    whole = Poses.of(np.array([x.p for x in every]).reshape(-1, 3), np.array([x.q for x in every]).reshape(-1, 4))
    n = len(every) // max(len(poses), 1)
    spans = {name: slice(k * n, (k + 1) * n) for k, name in enumerate(poses)}
    return {name: Poses(whole.p[span], whole.R[span]) for name, span in spans.items()}


UP = np.array([0.0, 0.0, 1.0])

# The axes of both bounding boxes as indices in TURNED, and as columns of rotation matrices.
BOX_AXES = np.array([[0, 1, 2], [3, 4, 2]])
BOX_BASES = TURNED[BOX_AXES].transpose(0, 2, 1)


class Boxes(NamedTuple):
    """The bounding box of an entity in its own frame, and a second box that is rotated by 45 degrees about the z axis.

    All arrays contain one row for each of the two boxes.

    Attributes:
        center: The centers in the world [m], shape (2, n, 3).
        half: The half extents [m], shape (2, n, 3).
        R: The axes as rotation matrices, shape (2, n, 3, 3).
    """

    center: Array
    half: Array
    R: Array

    @property
    def middle(self) -> Array:
        """The middle of the first box in the world [m], as an array of shape (n, 3)."""
        return np.asarray(self.center[0])

    @property
    def reach(self) -> Array:
        """The distance between the middle of the first box and its corners [m], as an array of shape (n,)."""
        return np.asarray(np.linalg.norm(self.half[0], axis=1))

    @property
    def size(self) -> Array:
        """The mean extent of the first box [m], as an array of shape (n,)."""
        return np.asarray(2 * self.half[0].mean(axis=1))


class Balls(NamedTuple):
    """The bounding balls of links in n states.

    Attributes:
        links: The index and the form of each link.
        center: The centers in the world [m], shape (n, links, 3).
        radius: The radii [m], shape (links,).
    """

    links: list[tuple[int, Form]]
    center: Array
    radius: Array


class View:
    """A view of ``n`` states of the bodies in a scene.

    If ``exact`` is set, large distances are measured too, instead of being bounded.
    """

    def __init__(self, bodies: Bodies, batch: StateBatch, exact: bool = False) -> None:
        self.bodies, self.batch, self.n, self.exact = bodies, batch, batch.n, exact
        self._links: dict[tuple[str, int], Poses] = {}
        self._boxes: dict[Entity, Boxes] = {}
        self._heights: dict[Entity, tuple[Array, Array]] = {}
        self._balls: dict[Entity, Balls] = {}

    def at(self, index: Index) -> View:
        """Return a view of the selected states."""
        view = View(self.bodies, self.batch.at(index), self.exact)
        view._links = {key: poses.at(index) for key, poses in self._links.items()}
        return view

    # -- poses ------------------------------------------------------------------------------------------------------

    def link(self, owner: str, k: int) -> Poses:
        """Return the poses X_WL of the k-th link of a body."""
        key = (owner, k)
        if key not in self._links:
            item = self.bodies[owner].item
            if k == 0:
                given = self.batch.poses.get(owner)
                self._links[key] = Poses.constant(item.X_WO, self.n) if given is None else given
            else:
                parent, joints = self.bodies[owner].parents[k]
                X_WL = self.link(owner, parent)
                for joint in joints:
                    X_WL = self._moved(owner, joint, X_WL.times(joint.X_PC))
                self._links[key] = X_WL
        return self._links[key]

    def place(self, owner: str, k: int, X_WL: Poses) -> None:
        """Move the k-th link of a body without moving its child links."""
        self._links[owner, k] = X_WL

    def _moved(self, owner: str, joint: Joint, X_WZ: Poses) -> Poses:
        name = f"{owner}.{joint.name}"
        if joint.type in (JointType.BALL, JointType.FREE):
            motion = self.batch.motions.get(name)
            return X_WZ.times(joint.motion) if motion is None else X_WZ @ motion
        if joint.type is JointType.FIXED:
            return X_WZ
        at = self.position(owner, joint)
        if joint.type is JointType.PRISMATIC:
            return Poses(X_WZ.p + rotate(X_WZ.R, at[:, None] * joint.axis), X_WZ.R)
        return Poses(X_WZ.p, X_WZ.R @ self.bodies[owner].turns[joint.name].by(at))

    def position(self, owner: str, joint: Joint) -> Array:
        """Return the position of a joint [rad or m], as an array of shape (n,)."""
        given = self.batch.robots if owner in self.bodies.robots else self.batch.joints
        at = given.get(f"{owner}.{joint.name}")
        return np.full(self.n, joint.position) if at is None else at

    def frame(self, thing: Entity) -> Poses:
        """Return the frame of an entity, which is the frame of its first link."""
        return self.link(thing.owner, thing.links[0])

    def forms(self, thing: Entity) -> list[tuple[int, Form]]:
        """Return the index and the form of each link of an entity that has a shape."""
        forms = self.bodies[thing.owner].forms
        return [(k, form) for k in thing.links if (form := forms[k]) is not None]

    def balls(self, thing: Entity) -> Balls:
        """Return the bounding balls of the solid links of an entity."""
        if thing not in self._balls:
            solid = [(k, form) for k, form in self.forms(thing) if form.solid]
            centers = [self.link(thing.owner, k) for k, _ in solid]
            around = [X.p + X.R @ form.ball[0] for X, (_, form) in zip(centers, solid, strict=True)]
            stacked = np.stack(around, axis=1) if around else np.zeros((self.n, 0, 3))
            self._balls[thing] = Balls(solid, stacked, np.array([form.ball[1] for _, form in solid]))
        return self._balls[thing]

    # -- extents ----------------------------------------------------------------------------------------------------

    def span(self, thing: Entity, axis: Array) -> tuple[Array, Array]:
        """Return the minimum and maximum coordinates [m] of an entity along an axis, as arrays of shape (n,).

        ``axis`` is a unit vector with shape (3,), or one unit vector per state with shape (n, 3). For several axes at
        once, shape (m, n, 3), the results have the shape (m, n).
        """
        axis = np.broadcast_to(axis, (*axis.shape[:-2], self.n, 3))
        low, high = np.full(axis.shape[:-1], np.inf), np.full(axis.shape[:-1], -np.inf)
        for k, form in self.forms(thing):
            X_WL = self.link(thing.owner, k)
            local = np.einsum("nji,...nj->...ni", X_WL.R, axis)
            offset = np.einsum("ni,...ni->...n", X_WL.p, axis)
            points, radius = form.support(self.n)
            reach = local @ points.T
            below, above = (reach - radius, reach + radius) if radius.any() else (reach, reach)
            low = np.minimum(low, offset + below.min(axis=-1))
            high = np.maximum(high, offset + above.max(axis=-1))
        return low, high

    def heights(self, thing: Entity) -> tuple[Array, Array]:
        """Return the heights [m] of the lowest and highest points above the ground, as arrays of shape (n,)."""
        if thing not in self._heights:
            self._heights[thing] = self.span(thing, UP)
        return self._heights[thing]

    def aabb_middle(self, thing: Entity) -> Array:
        """Return the middle [m] of an entity's bounding box along the world axes, as an array of shape (n, 3)."""
        spans = [self.span(thing, axis) for axis in np.eye(2, 3)] + [self.heights(thing)]
        return np.stack([(low + high) / 2 for low, high in spans], axis=1)

    def boxes(self, thing: Entity) -> Boxes:
        """Return the bounding boxes of an entity."""
        if thing not in self._boxes:
            forms, X_WF = self.forms(thing), self.frame(thing)
            if len(forms) == 1 and forms[0][0] == thing.links[0]:
                low, high = (np.broadcast_to(v, (self.n, 5)) for v in (forms[0][1].low, forms[0][1].high))
            else:
                spans = [self.span(thing, X_WF.R @ u) for u in TURNED]
                origin = np.einsum("nij,ni->nj", X_WF.R, X_WF.p) @ TURNED.T
                low, high = (np.stack([s[k] for s in spans], axis=1) - origin for k in (0, 1))
            span = (low + high)[:, BOX_AXES].transpose(1, 0, 2) / 2  # (box, n, axis)
            axes = X_WF.R @ BOX_BASES[:, None]
            center = X_WF.p + np.einsum("bnij,bnj->bni", axes, span)
            self._boxes[thing] = Boxes(center, (high - low)[:, BOX_AXES].transpose(1, 0, 2) / 2, axes)
        return self._boxes[thing]


def over(points: Array, boxes: Boxes) -> Array:
    """Return the horizontal distance [m] between points and the edge of the outline of both boxes.

    The outline of a box is its silhouette as seen from above, a hexagon whose sides are edges of the box. The distance,
    an array of shape (n,), is negative outside the outline of either box.
    """
    edges = boxes.half[..., None] * boxes.R[:, :, :2, :].swapaxes(2, 3)  # (box, n, edge, xy)
    length = np.linalg.norm(edges, axis=3)
    lying = length > 1e-9
    normal = np.stack([-edges[..., 1], edges[..., 0]], axis=3) / np.where(lying, length, 1.0)[..., None]
    reach = np.abs(edges @ normal.swapaxes(2, 3)).sum(axis=2)
    away = np.abs(((points - boxes.center)[:, :, None, :2] * normal).sum(axis=3))
    return np.asarray(np.where(lying, reach - away, np.inf).min(axis=(0, 2)))


def ground_gap(view: View, a: Entity, b: Entity) -> Array:
    """Return the horizontal distance [m] between two entities, as an array of shape (n,).

    The distance is negative if the entities overlap. It is the largest of the gaps across the edges of their boxes and
    along the line between their middles.
    """
    boxes = view.boxes(a), view.boxes(b)
    ways = np.zeros((7, view.n, 2))
    ways[0] = (boxes[0].middle - boxes[1].middle)[:, :2]
    for first, box in zip((1, 4), boxes, strict=True):
        for k in range(3):
            ways[first + k, :, 0], ways[first + k, :, 1] = -box.R[0, :, 1, k], box.R[0, :, 0, k]
    size = np.linalg.norm(ways, axis=2)
    lying = size > 1e-6
    axes = np.zeros((7, view.n, 3))
    axes[:, :, :2] = ways / np.where(lying, size, 1.0)[:, :, None]
    (low_a, high_a), (low_b, high_b) = view.span(a, axes), view.span(b, axes)
    gap = np.where(lying, np.maximum(low_a - high_b, low_b - high_a), -np.inf)
    return np.asarray(gap.max(axis=0))
