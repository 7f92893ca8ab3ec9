"""Signed distances between links in many states, including bounds, candidate pairs of nearest parts, and exact values.

Exact distances are computed by MuJoCo's collision functions, with geom poses that this module sets directly.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from simfoundry.geometry.bounds import BoxField, Interval, box_field, distance_bounds
from simfoundry.geometry.form import Form
from simfoundry.geometry.frames import Array, Index, Pose, Poses, rotate
from simfoundry.geometry.hulls import convex_core
from simfoundry.geometry.shapes import Box, Capsule, Cone, Cylinder, Ellipsoid, Geometry, Mesh, Sphere

# Height by which an object is raised to find contact directions [m]. It is larger than the penetration that engines
# allow and smaller than the radii of round parts.
LIFT = 0.001

# Distance or penetration [m] below which the direction between two parts is treated as undefined; distances are
# accurate to 1e-6 m.
VANISHING = 1e-5

UP = np.array([0.0, 0.0, 1.0])


class Candidates(NamedTuple):
    """Pairs of parts that may be close to each other, stored as arrays of shape (m,).

    Attributes:
        state: Index of the state.
        one: Index of the part in the first link.
        other: Index of the part in the second link.
        bound: Lower bound on the distance between the two parts [m].
    """

    state: Index
    one: Index
    other: Index
    bound: Array


# Shapes, each with its pose in the link frame.
Shapes = Sequence[tuple[Geometry, Pose]]


class Exact:
    """Exact distances between links, computed from MuJoCo geoms that represent the shapes.

    Links are identified by object name and link index. MuJoCo is only used to measure distances: the geom poses are set
    here, and the model is never stepped.
    """

    def __init__(self, links: Mapping[tuple[str, int], Shapes]) -> None:
        import mujoco

        spec = mujoco.MjSpec()
        ids = iter(range(sum(map(len, links.values()))))
        self._geoms = {key: np.array([next(ids) for _ in shapes], dtype=np.int64) for key, shapes in links.items()}
        meshes: dict[int, str] = {}
        for shapes in links.values():
            for geometry, X_LG in shapes:
                _add_geom(spec, geometry, X_LG, meshes)
        self._distance = mujoco.mj_geomDistance
        self._model = spec.compile()
        self._data = mujoco.MjData(self._model)
        self._X_LG = Poses.of(self._model.geom_pos, self._model.geom_quat)

    def distance(self, pair: LinkPair, near: Candidates, most: Array, enough: float = -np.inf) -> Array:
        """Compute the signed distance between two links in each state.

        Args:
            pair: The two links.
            near: Pairs of parts that may be closer than ``most``.
            most: Maximum distance to return [m], shape (n,).
            enough: Distance [m] at or below which the search in a state stops.

        Returns:
            Signed distances [m], shape (n,), which are negative if the links overlap.
        """
        first, second, place = self._placing(pair, pair.X_WA)
        measure, model, data = self._distance, self._model, self._data
        out = most.tolist()
        last = -1
        for state, i, j, bound in zip(*(column.tolist() for column in near), strict=True):
            best = out[state]
            if bound >= best or best <= enough:
                continue
            if state != last:
                place(state)
                last = state
            out[state] = min(best, measure(model, data, first + i, second + j, max(best, 1e-3), None))
        return np.array(out)

    def pushes(
        self, pair: LinkPair, near: Candidates, limit: float, enough: float = np.inf
    ) -> tuple[Index, Array, Array]:
        """Return the directions in which parts of the second link push nearby parts of the first link.

        The first link is raised by :data:`LIFT` during the measurement, because no direction is defined between two
        parts that barely touch.

        Args:
            pair: The two links.
            near: Pairs of parts that may be close enough.
            limit: Maximum distance between two parts [m].
            enough: Cosine between a direction and the vertical at or above which the search in a state stops.

        Returns:
            The state index of each pair of parts, shape (m,), the distance between the parts [m], shape (m,), and the
            unit vector from the second part to the first, shape (m, 3).
        """
        first, second, place = self._placing(pair, Poses(pair.X_WA.p + LIFT * UP, pair.X_WA.R))
        measure, model, data, ends = self._distance, self._model, self._data, np.zeros(6)
        reach = limit + 2 * LIFT
        found: list[tuple[int, float, list[float]]] = []
        last = done = -1
        for state, i, j in zip(near.state.tolist(), near.one.tolist(), near.other.tolist(), strict=True):
            if state == done:
                continue
            if state != last:
                place(state)
                last = state
            raised = measure(model, data, first + i, second + j, reach, ends)
            if raised > limit + LIFT:
                continue
            if abs(raised) < VANISHING:  # the raised parts barely touch: raise the first one slightly more
                data.geom_xpos[first + i, 2] += VANISHING
                raised = measure(model, data, first + i, second + j, reach, ends)
                data.geom_xpos[first + i, 2] -= VANISHING
            fx, fy, fz, tx, ty, tz = ends.tolist()
            way = [(fx - tx) / raised, (fy - ty) / raised, (fz - tz) / raised] if raised else [0.0, 0.0, 0.0]
            gap = raised - LIFT * way[2]
            if gap > limit:
                continue
            found.append((state, gap, way))
            if way[2] >= enough:
                done = state
        states, gaps, ways = zip(*found, strict=True) if found else ((), (), ())
        return np.array(states, dtype=np.int64), np.array(gaps, dtype=float), np.array(ways).reshape(-1, 3)

    def _placing(self, pair: LinkPair, X_WA: Poses) -> tuple[int, int, Callable[[int], None]]:
        """Return the first geom of each link, and a function that poses both links as in a given state."""
        geoms_a, geoms_b = self._geoms[pair.a], self._geoms[pair.b]
        at = (*self._poses(geoms_a, X_WA), *self._poses(geoms_b, pair.X_WB))
        first, second = int(geoms_a[0]), int(geoms_b[0])  # the geoms of a link have consecutive indices
        rows_a, rows_b = slice(first, first + len(geoms_a)), slice(second, second + len(geoms_b))
        xpos, xmat = self._data.geom_xpos, self._data.geom_xmat

        def place(state: int) -> None:
            xpos[rows_a], xmat[rows_a], xpos[rows_b], xmat[rows_b] = (x[state] for x in at)

        return first, second, place

    def _poses(self, geoms: Index, X_WL: Poses) -> tuple[Array, Array]:
        """Return the positions and rotations of a link's geoms.

        Returns:
            Positions [m], shape (n, geoms, 3), and rotations, shape (n, geoms, 9).
        """
        p = X_WL.p[:, None] + self._X_LG.p[geoms] @ X_WL.R.transpose(0, 2, 1)
        turn = X_WL.R[:, None] @ self._X_LG.R[geoms]
        return p, turn.reshape(len(p), -1, 9)


def _add_geom(spec: Any, geometry: Geometry, X_LG: Pose, meshes: dict[int, str]) -> None:
    """Add a geom to the world body of a model.

    ``meshes`` maps the ``id`` of each mesh added so far to its name.
    """
    import mujoco

    kinds = mujoco.mjtGeom
    size, mesh = [0.0, 0.0, 0.0], ""
    match geometry:
        case Box():
            kind, size = kinds.mjGEOM_BOX, (geometry.size / 2).tolist()
        case Sphere():
            kind, size = kinds.mjGEOM_SPHERE, [geometry.radius, 0.0, 0.0]
        case Ellipsoid():
            kind, size = kinds.mjGEOM_ELLIPSOID, geometry.radii.tolist()
        case Cylinder():
            kind, size = kinds.mjGEOM_CYLINDER, [geometry.radius, geometry.height / 2, 0.0]
        case Capsule():
            kind, size = kinds.mjGEOM_CAPSULE, [geometry.radius, geometry.height / 2, 0.0]
        case Mesh() | Cone():
            kind = kinds.mjGEOM_MESH
            if id(geometry) not in meshes:
                meshes[id(geometry)] = f"m{len(meshes)}"
                corners, triangles, _, _ = convex_core(geometry)
                spec.add_mesh(
                    name=meshes[id(geometry)],
                    uservert=corners.ravel(),
                    userface=triangles.ravel(),
                    inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX,
                )
            mesh = meshes[id(geometry)]
    spec.worldbody.add_geom(type=kind, size=size, meshname=mesh, pos=X_LG.p, quat=X_LG.q)


def steepest_together(ways: Array) -> float:
    """Return the largest cosine between the vertical and a nonnegative combination of k unit vectors."""
    from scipy.optimize import nnls

    # The best combination is the projection of `UP` onto the cone spanned by the vectors; its length is the cosine.
    return float(np.sqrt(max(0.0, 1 - nnls(ways.T, UP)[1] ** 2)))


class LinkPair:
    """Two links, each identified by object name and link index, in n states."""

    def __init__(
        self, a: tuple[str, int], b: tuple[str, int], one: Form, other: Form, X_WA: Poses, X_WB: Poses
    ) -> None:
        self.a, self.b, self.one, self.other, self.X_WA, self.X_WB = a, b, one, other, X_WA, X_WB

    def at(self, index: Index) -> LinkPair:
        """Select states by index."""
        return LinkPair(self.a, self.b, self.one, self.other, self.X_WA.at(index), self.X_WB.at(index))


def bound_distances(pair: LinkPair, threshold: float, by_parts: bool) -> tuple[Array, Index]:
    """Compute distance bounds that suffice to compare most distances with a threshold [m].

    If one link is a single box, the corners of the other link's hull are sufficient in nearly all states.

    Args:
        pair: The two links.
        threshold: The threshold [m].
        by_parts: True if the remaining states are decided using bounds on the distances between parts.

    Returns:
        A bound on the distance in each state [m], shape (n,), and the indices of the undecided states.
    """
    n = len(pair.X_WA.p)
    found, open_ = np.full(n, -np.inf), np.arange(n)
    if (seen := from_box(pair)) is not None:
        lower, upper = seen.lower(), seen.upper()
        found = np.where(upper <= threshold, upper, lower).astype(np.float64)
        open_ = np.flatnonzero((lower <= threshold) & (upper > threshold))
    for k in open_.tolist() if by_parts else ():
        bounds = _part_bounds(pair, k, threshold)
        if bounds.upper <= threshold or bounds.lower > threshold:
            found[k] = bounds.upper if bounds.upper <= threshold else bounds.lower
            open_ = open_[open_ != k]
    return found, open_


def bound_support(pair: LinkPair, limit: float, steepest: float, by_parts: bool) -> tuple[Array, Array, Index]:
    """Compute bounds that suffice in most states to decide if the second link supports the first.

    If one link is a single box, the corners of the other link's hull are usually sufficient.

    Args:
        pair: The two links.
        limit: Maximum distance of a supporting link [m].
        steepest: Minimum cosine between the vertical and the push of a supporting link.
        by_parts: True if the remaining states are decided using bounds on the distances between parts.

    Returns:
        A bound on the distance [m] and a bound on the support cosine in each state, shape (n,) each, and the indices of
        the undecided states.
    """
    n = len(pair.X_WA.p)
    apart, up, open_ = np.full(n, np.inf), np.full(n, -1.0), np.arange(n)
    if (seen := from_box(pair)) is not None:
        lower, upper = seen.lower(), seen.upper()
        rise = (seen.lower(LIFT) - upper) / LIFT
        stands = (upper <= limit) & (rise >= steepest)
        apart = np.where(stands, upper, np.where(lower > limit, lower, np.inf)).astype(np.float64)
        up, open_ = np.where(stands, rise, -1.0).astype(np.float64), np.flatnonzero(~stands & (lower <= limit))
    for k in open_.tolist() if by_parts else ():
        bounds = _part_bounds(pair, k, limit)
        if bounds.lower > limit:
            apart[k], open_ = bounds.lower, open_[open_ != k]
            continue
        part_rise = (_part_bounds(pair, k, limit + LIFT, LIFT).lower - bounds.upper) / LIFT
        if bounds.upper <= limit and part_rise >= steepest:
            apart[k], up[k], open_ = bounds.upper, part_rise, open_[open_ != k]
    return apart, up, open_


def _part_bounds(pair: LinkPair, k: int, limit: float, raised: float = 0.0) -> Interval:
    """Return bounds on the distance in the k-th state, with the first link raised by ``raised`` [m]."""
    X_WA, X_WB = (pair.X_WA.p[k] + raised * UP, pair.X_WA.R[k]), (pair.X_WB.p[k], pair.X_WB.R[k])
    return distance_bounds(pair.one, pair.other, X_WA, X_WB, np.nextafter(limit, np.inf))


class FromBox(NamedTuple):
    """The hull of one link in n states, expressed in the frame of a second link that is a single box.

    Attributes:
        field: Distance field of the box.
        local: Centers of the balls that span the hull [m], shape (n, m, 3).
        radius: Radii of the balls [m], shape (m,).
        low: Minimum corner of the hull's bounding box [m], shape (n, 3).
        high: Maximum corner of the hull's bounding box [m], shape (n, 3).
        up: Direction in which the hull moves relative to the box when the first link is raised, shape (n, 3).
    """

    field: BoxField
    local: NDArray[np.float32]
    radius: NDArray[np.float32]
    low: NDArray[np.float32]
    high: NDArray[np.float32]
    up: NDArray[np.float32]

    def lower(self, raised: float = 0.0) -> Array:
        """Return a lower bound on the distance [m] with the first link raised by ``raised`` [m].

        The bound is an array of shape (n,).
        """
        move = np.float32(raised) * self.up
        return self.field.lower(self.low + move, self.high + move)

    def upper(self) -> Array:
        """Return an upper bound on the distance [m], as an array of shape (n,)."""
        return self.field.upper(self.local, self.radius)


def from_box(pair: LinkPair) -> FromBox | None:
    """Express a pair of links in the frame of the link that is a single box.

    Returns None if neither link is a single box.
    """
    one, other, X_WA, X_WB, sign = pair.one, pair.other, pair.X_WA, pair.X_WB, 1.0
    if box_field(other) is None:
        one, other, X_WA, X_WB, sign = other, one, X_WB, X_WA, -1.0
    field = box_field(other)
    if field is None:
        return None
    X_BA = X_WB.inverse() @ X_WA
    p, turned = X_BA.p.astype(np.float32), X_BA.R.transpose(0, 2, 1).astype(np.float32)
    corners, radii = one.support(len(p))
    points = corners.astype(np.float32) @ turned + p[:, None]
    up = sign * X_WB.R[:, 2].astype(np.float32) @ field.axes
    local, radius = field.local(points), radii.astype(np.float32)
    low, high = (local - radius[:, None]).min(axis=1), (local + radius[:, None]).max(axis=1)
    return FromBox(field, local, radius, low, high, np.asarray(up, dtype=np.float32))


def ball_bound(X_WA: Poses, a: Form, X_WB: Poses, b: Form) -> Array:
    """Return a lower bound on the distance between two links [m], as an array of shape (n,).

    The bound is the distance from each link's bounding sphere to the other link's bounding box.
    """
    (ball_a, size_a), (ball_b, size_b) = a.ball, b.ball
    middle_a, middle_b = X_WA.p + X_WA.R @ ball_a, X_WB.p + X_WB.R @ ball_b
    b_in_a = rotate(X_WA.R.transpose(0, 2, 1), middle_b - X_WA.p)
    a_in_b = rotate(X_WB.R.transpose(0, 2, 1), middle_a - X_WB.p)
    first = _beyond(b_in_a, a.low[:3], a.high[:3]) - size_b
    second = _beyond(a_in_b, b.low[:3], b.high[:3]) - size_a
    return np.asarray(np.maximum(first, second))


def candidates(pair: LinkPair, most: Array) -> Candidates:
    """Return the pairs of parts that may be closer than a distance, sorted by state and distance.

    Args:
        pair: The two links.
        most: The distance in each state [m], shape (n,).
    """
    X_AB = pair.X_WA.inverse() @ pair.X_WB
    low_a, high_a, ball_a, size_a = pair.one.pieces
    low_b, high_b, ball_b, size_b = pair.other.pieces
    b_in_a = X_AB.p[:, None] + ball_b @ X_AB.R.transpose(0, 2, 1)
    reach = most[:, None, None] + (size_a[:, None] + size_b)
    squares = (b_in_a**2).sum(axis=2)[:, None] + (ball_a**2).sum(axis=1)[:, None]
    square = squares - 2 * (ball_a @ b_in_a.transpose(0, 2, 1))
    state, i, j = np.nonzero(square < reach**2 * (reach > 0))
    a_in_b = (ball_a - X_AB.p[:, None]) @ X_AB.R
    bound = _beyond(b_in_a[state, j], low_a[i], high_a[i]) - size_b[j]
    bound = np.maximum(bound, _beyond(a_in_b[state, i], low_b[j], high_b[j]) - size_a[i])
    kept = np.flatnonzero(bound < most[state])
    kept = kept[np.lexsort((bound[kept], state[kept]))]
    return Candidates(state[kept], i[kept], j[kept], bound[kept])


def _beyond(points: Array, low: Array, high: Array) -> Array:
    """Return the distances [m] from points to boxes, which are 0 for points inside a box."""
    off = np.maximum(np.maximum(low - points, points - high), 0.0)
    return np.asarray(np.sqrt(np.einsum("...i,...i->...", off, off)))
