"""Exact signed distances between convex parts, from MuJoCo's collision functions at poses that we set."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from simfoundry.geometry.frames import Array, Pose
from simfoundry.geometry.poses import Index, Poses
from simfoundry.geometry.shapes import Box, Capsule, Cylinder, Geometry, Mesh, Sphere

LIFT = 0.001
"""Height by which an object is raised to find contact directions [m]: larger than the penetration that engines allow,
smaller than the radii of round parts."""

VANISHING = 1e-5
"""Distance or penetration [m] below which the direction between parts is undefined: distances are accurate to 1e-6."""

UP = np.array([0.0, 0.0, 1.0])


class Candidates(NamedTuple):
    """Pairs of parts, (m,): the state, the part's index in each link, and a lower bound of their distance [m]."""

    state: Index
    one: Index
    other: Index
    bound: Array


Shapes = Sequence[tuple[Geometry, Pose]]
"""Shapes with their poses in a link."""


class Exact:
    """Shapes of links, by name and index, as MuJoCo geoms; MuJoCo neither steps nor places them."""

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

    def distance(
        self,
        a: tuple[str, int],
        b: tuple[str, int],
        X_WA: Poses,
        X_WB: Poses,
        near: Candidates,
        most: Array,
        enough: float = -np.inf,
    ) -> Array:
        """Signed distance [m] between two links, (n,), negative if they overlap; at most ``most`` [m], (n,).

        ``near`` are the parts that may be closer than that. The search ends at parts no farther apart than ``enough``
        [m].
        """
        geoms_a, geoms_b = self._geoms[a], self._geoms[b]
        at_a, at_b = self._poses(geoms_a, X_WA), self._poses(geoms_b, X_WB)
        first, second = int(geoms_a[0]), int(geoms_b[0])  # the geoms of a link follow one another
        rows_a, rows_b = slice(first, first + len(geoms_a)), slice(second, second + len(geoms_b))
        xpos, xmat = self._data.geom_xpos, self._data.geom_xmat
        measure, model, data = self._distance, self._model, self._data
        out = most.tolist()
        last = -1
        for state, i, j, bound in zip(*(column.tolist() for column in near), strict=True):
            best = out[state]
            if bound >= best or best <= enough:
                continue
            if state != last:
                xpos[rows_a], xmat[rows_a], xpos[rows_b], xmat[rows_b] = (x[state] for x in (*at_a, *at_b))
                last = state
            out[state] = min(best, measure(model, data, first + i, second + j, max(best, 1e-3), None))
        return np.array(out)

    def pushes(
        self,
        a: tuple[str, int],
        b: tuple[str, int],
        X_WA: Poses,
        X_WB: Poses,
        near: Candidates,
        limit: float,
        enough: float = np.inf,
    ) -> tuple[Index, Array, Array]:
        """Directions in which parts of one link push parts of another that are no farther than ``limit`` [m].

        Returns the state of each such pair, (m,), its distance [m], (m,), and the unit vector from the second to the
        first, (m, 3). A direction whose cosine with up is at least ``enough`` ends the search in its state.

        The first link is raised by :data:`LIFT` for the measurement, because the direction between parts that just
        touch is undefined.
        """
        geoms_a, geoms_b = self._geoms[a], self._geoms[b]
        at_a, at_b = self._poses(geoms_a, Poses(X_WA.p + LIFT * UP, X_WA.R)), self._poses(geoms_b, X_WB)
        first, second = int(geoms_a[0]), int(geoms_b[0])  # the geoms of a link follow one another
        rows_a, rows_b = slice(first, first + len(geoms_a)), slice(second, second + len(geoms_b))
        xpos, xmat = self._data.geom_xpos, self._data.geom_xmat
        measure, model, data, ends = self._distance, self._model, self._data, np.zeros(6)
        reach = limit + 2 * LIFT
        states: list[int] = []
        gaps: list[float] = []
        ways: list[list[float]] = []
        last = done = -1
        for state, i, j in zip(near.state.tolist(), near.one.tolist(), near.other.tolist(), strict=True):
            if state == done:
                continue
            if state != last:
                xpos[rows_a], xmat[rows_a], xpos[rows_b], xmat[rows_b] = (x[state] for x in (*at_a, *at_b))
                last = state
            raised = measure(model, data, first + i, second + j, reach, ends)
            if raised > limit + LIFT:
                continue
            if abs(raised) < VANISHING:  # raising has made it just touch: raise it slightly more
                xpos[first + i, 2] += VANISHING
                raised = measure(model, data, first + i, second + j, reach, ends)
                xpos[first + i, 2] -= VANISHING
            fx, fy, fz, tx, ty, tz = ends.tolist()
            way = [(fx - tx) / raised, (fy - ty) / raised, (fz - tz) / raised] if raised else [0.0, 0.0, 0.0]
            gap = raised - LIFT * way[2]
            if gap > limit:
                continue
            states.append(state)
            gaps.append(gap)
            ways.append(way)
            if way[2] >= enough:
                done = state
        return np.array(states, dtype=np.int64), np.array(gaps), np.array(ways).reshape(-1, 3)

    def _poses(self, geoms: Index, X_WL: Poses) -> tuple[Array, Array]:
        """Positions and rotations of the geoms of a link: (n, geoms, 3) and (n, geoms, 9)."""
        p = X_WL.p[:, None] + self._X_LG.p[geoms] @ X_WL.R.transpose(0, 2, 1)
        turn = X_WL.R[:, None] @ self._X_LG.R[geoms]
        return p, turn.reshape(len(p), -1, 9)


def _add_geom(spec: Any, geometry: Geometry, X_LG: Pose, meshes: dict[int, str]) -> None:
    """Add a geom to a model's world body; ``meshes`` are the names of its meshes, by identity."""
    import mujoco

    kinds = mujoco.mjtGeom
    size, mesh = [0.0, 0.0, 0.0], ""
    match geometry:
        case Box():
            kind, size = kinds.mjGEOM_BOX, (geometry.size / 2).tolist()
        case Sphere():
            kind, size = kinds.mjGEOM_SPHERE, [geometry.radius, 0.0, 0.0]
        case Cylinder():
            kind, size = kinds.mjGEOM_CYLINDER, [geometry.radius, geometry.height / 2, 0.0]
        case Capsule():
            kind, size = kinds.mjGEOM_CAPSULE, [geometry.radius, geometry.height / 2, 0.0]
        case Mesh():
            kind = kinds.mjGEOM_MESH
            if id(geometry) not in meshes:
                meshes[id(geometry)] = f"m{len(meshes)}"
                spec.add_mesh(
                    name=meshes[id(geometry)],
                    uservert=geometry.vertices.ravel(),
                    userface=geometry.faces.ravel(),
                    inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX,
                )
            mesh = meshes[id(geometry)]
    spec.worldbody.add_geom(type=kind, size=size, meshname=mesh, pos=X_LG.p, quat=X_LG.q)
