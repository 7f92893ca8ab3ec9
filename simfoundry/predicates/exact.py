"""The exact signed distance between convex parts, by MuJoCo's collision functions on poses that we set."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from simfoundry.backends.mjcf import compile_mjcf
from simfoundry.predicates.batch import Index, Poses
from simfoundry.predicates.shapes import Bodies
from simfoundry.scene.frames import Array, frozen_array
from simfoundry.scene.model import Scene

NO_GEOMS = np.zeros(0, np.int64)


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
        bounds: Array,
        limit: Array,
    ) -> Array:
        """Signed distance [m] between two links, (n,), negative where they overlap; at most ``limit`` [m], (n,).

        ``bounds`` are distances [m] that the parts of the two have at least, shape (n, parts of a, parts of b).
        """
        geoms_a, geoms_b = self._geoms[a], self._geoms[b]
        out = np.array(limit, dtype=np.float64)
        for i in range(len(out)):
            near = np.argwhere(bounds[i] < out[i])
            if not len(near):
                continue
            near = near[np.argsort(bounds[i][near[:, 0], near[:, 1]], kind="stable")]
            self._put(geoms_a[np.unique(near[:, 0])], X_WA.p[i], X_WA.R[i])
            self._put(geoms_b[np.unique(near[:, 1])], X_WB.p[i], X_WB.R[i])
            best = float(out[i])
            for j, k in near:
                if bounds[i, j, k] >= best:
                    break
                best = min(best, self._distance(self._model, self._data, geoms_a[j], geoms_b[k], max(best, 1e-3), None))
            out[i] = best
        return out

    def _put(self, geoms: Index, p: Array, turn: Array) -> None:
        self._data.geom_xpos[geoms] = p + self._X_LG.p[geoms] @ turn.T
        self._data.geom_xmat[geoms] = (turn @ self._X_LG.R[geoms]).reshape(-1, 9)
