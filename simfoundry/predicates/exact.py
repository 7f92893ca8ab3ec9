"""The exact signed distance between convex parts, by MuJoCo's collision functions on poses that we set."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from simfoundry.backends.mjcf import compile_mjcf
from simfoundry.predicates.batch import Index, Poses
from simfoundry.predicates.shapes import Bodies
from simfoundry.scene.frames import Array, frozen_array
from simfoundry.scene.model import Scene


class Candidates(NamedTuple):
    """Pairs of parts, (m,): the state, the index of a part in either link, and a least distance [m] of the two."""

    state: Index
    one: Index
    other: Index
    bound: Array


class Exact:
    """All colliders of a scene's bodies as MuJoCo's geoms. MuJoCo neither steps nor places anything here."""

    def __init__(self, bodies: Bodies) -> None:
        import mujoco

        items = tuple(replace(o, links=tuple(replace(k, visuals=()) for k in o.links)) for o in bodies.items)
        files = compile_mjcf(Scene("distances", frozen_array([0.0, 0.0, 0.0]), items)).files
        assets = {path: data for path, data in files.items() if path.startswith("assets/")}
        self._distance = mujoco.mj_geomDistance
        self._model = mujoco.MjModel.from_xml_string(files["scene.xml"].decode(), assets)
        self._data = mujoco.MjData(self._model)
        self._geoms: dict[tuple[str, int], Index] = {}
        for item in bodies.items:
            for k, link in enumerate(item.links):
                name = item.qualified(link.name)
                ids = [self._model.geom(f"{name}.{collider.name}").id for collider in link.colliders]
                self._geoms[item.name, k] = np.array(ids, dtype=np.int64)
        every = [Poses.of(self._model.geom_pos, self._model.geom_quat)]
        self._X_LG = every[0]

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
        """Signed distance [m] between two links, (n,), negative where they overlap; at most ``most`` [m], (n,).

        ``near`` are the parts that may be nearer than that. Parts at no more than ``enough`` [m] end the search.
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

    def lifted(
        self,
        a: tuple[str, int],
        b: tuple[str, int],
        X_WA: Poses,
        X_WB: Poses,
        near: Candidates,
        offsets: Array,
        limit: float,
        enough: float = np.inf,
        least: float = -np.inf,
    ) -> tuple[Array, Array, Array]:
        """How pairs of parts from ``least`` to ``limit`` [m] apart come apart where the first link is moved.

        ``offsets`` [m], (k, 3), are those of the first link in the world, one after another. Returns the state of each
        such pair, (m,), its distance [m], (m,), and by how much it grows with each offset [m], (m, k). A pair that
        grows by ``enough`` [m] with the first offset ends the search in its state.
        """
        geoms_a, geoms_b = self._geoms[a], self._geoms[b]
        at_a, at_b = self._poses(geoms_a, X_WA), self._poses(geoms_b, X_WB)
        first, second = int(geoms_a[0]), int(geoms_b[0])  # the geoms of a link follow one another
        rows_a, rows_b = slice(first, first + len(geoms_a)), slice(second, second + len(geoms_b))
        xpos, xmat = self._data.geom_xpos, self._data.geom_xmat
        measure, model, data = self._distance, self._model, self._data
        reach = limit + float(np.linalg.norm(offsets, axis=1).max()) + 1e-3  # a distance beyond it is cut off
        states: list[int] = []
        gaps: list[float] = []
        grown: list[list[float]] = []
        last = done = -1
        for state, i, j, bound in zip(*(column.tolist() for column in near), strict=True):
            if state == done or bound > limit:
                continue
            if state != last:
                xpos[rows_a], xmat[rows_a], xpos[rows_b], xmat[rows_b] = (x[state] for x in (*at_a, *at_b))
                last = state
            gap = measure(model, data, first + i, second + j, reach, None)
            if not least <= gap <= limit:
                continue
            at = at_a[0][state, i]
            moved = []
            for offset in offsets:
                xpos[first + i] = at + offset
                moved.append(measure(model, data, first + i, second + j, reach, None) - gap)
            xpos[first + i] = at
            states.append(state)
            gaps.append(gap)
            grown.append(moved)
            if moved[0] >= enough:
                done = state
        return np.array(states, dtype=np.int64), np.array(gaps), np.array(grown).reshape(-1, len(offsets))

    def _poses(self, geoms: Index, X_WL: Poses) -> tuple[Array, Array]:
        """Where the geoms of a link are: (n, geoms, 3) and (n, geoms, 9)."""
        p = X_WL.p[:, None] + self._X_LG.p[geoms] @ X_WL.R.transpose(0, 2, 1)
        turn = X_WL.R[:, None] @ self._X_LG.R[geoms]
        return p, turn.reshape(len(p), -1, 9)
