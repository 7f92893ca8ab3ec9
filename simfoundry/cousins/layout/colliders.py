"""Collision tests between objects on their convex parts: bounding volumes first, then MuJoCo's distance."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from simfoundry.backends.mjcf import compile_mjcf
from simfoundry.geometry.frames import Array, Pose, frozen_array
from simfoundry.geometry.poses import rotations
from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.model import Link, Scene, SceneObject

Index = NDArray[np.int64]


class Solids:
    """Collision geometry of objects as MuJoCo geoms, posed by :meth:`put`. MuJoCo neither steps nor places anything
    here.
    """

    def __init__(self, items: tuple[SceneObject, ...], joints: Mapping[str, Mapping[str, float | Pose]]) -> None:
        import mujoco

        bare = tuple(replace(o, links=tuple(map(_bare, o.links)), variants=(), no_contact=()) for o in items)
        files = compile_mjcf(Scene("solids", frozen_array([0.0, 0.0, 0.0]), bare), contacts="native").files
        assets = {path: data for path, data in files.items() if path.startswith("assets/")}
        self._distance = mujoco.mj_geomDistance
        self._model = mujoco.MjModel.from_xml_string(files["scene.xml"].decode(), assets)
        self._data = mujoco.MjData(self._model)
        self._own: dict[str, tuple[Index, Array, Array]] = {}
        self._boxes: dict[str, tuple[Array, Array]] = {}
        self._at: dict[str, tuple[Array, Array, Array]] = {}
        self._waiting: dict[str, Pose] = {}
        for item in items:
            self._own[item.name] = self._in_frame(item, joints.get(item.name, {}))
            self.put(item.name, item.X_WO)

    def _in_frame(self, item: SceneObject, joints: Mapping[str, float | Pose]) -> tuple[Index, Array, Array]:
        """Geoms of an object and their poses in its frame: positions (k, 3), rotations (k, 3, 3)."""
        ids, p, turned = [np.zeros(0, np.int64)], [np.zeros((0, 3))], [np.zeros((0, 3, 3))]
        poses = link_poses(item, joints)
        for link in item.links:
            name, X_OL = item.qualified(link.name), poses[link.name]
            geoms = np.array([self._model.geom(f"{name}.{c.name}").id for c in link.colliders], dtype=np.int64)
            ids.append(geoms)
            p.append(X_OL.apply(self._model.geom_pos[geoms]))
            turned.append(X_OL.rotation @ rotations(self._model.geom_quat[geoms].reshape(-1, 4)))
        every = np.concatenate(ids)
        box = self._model.geom_aabb[every]
        self._boxes[item.name] = box[:, :3].copy(), box[:, 3:].copy()
        return every, np.concatenate(p), np.concatenate(turned)

    def put(self, name: str, X_WO: Pose) -> None:
        """Pose an object; its parts are updated lazily, when they are queried."""
        self._waiting[name] = X_WO

    def _posed(self, name: str) -> tuple[Array, Array, Array]:
        """Bounding boxes of the parts: centers [m] (k, 3), rotations (k, 3, 3), radii of their bounding spheres [m]
        (k,).
        """
        X_WO = self._waiting.pop(name, None)
        if X_WO is None:
            return self._at[name]
        geoms, p, turned = self._own[name]
        points, turns = X_WO.apply(p), X_WO.rotation @ turned
        self._data.geom_xpos[geoms] = points
        self._data.geom_xmat[geoms] = turns.reshape(-1, 9)
        middle, half = self._boxes[name]
        middles = points + np.einsum("kij,kj->ki", turns, middle)
        self._at[name] = middles, turns, np.sqrt((half * half).sum(axis=1))
        return self._at[name]

    def meet(self, a: str, b: str, gap: float) -> bool:
        """Return whether two objects overlap or are closer to each other than ``gap`` [m]."""
        mine, yours = self._own[a][0], self._own[b][0]
        for i, j, _ in self._near(a, b, gap):
            if self._distance(self._model, self._data, mine[i], yours[j], gap + 1e-3, None) < gap:
                return True
        return False

    def distance(self, a: str, b: str, far: float) -> float:
        """Signed distance between two objects [m], negative if they overlap, capped at ``far``."""
        mine, yours = self._own[a][0], self._own[b][0]
        best = far
        for i, j, bound in self._near(a, b, far):
            if bound >= best:
                break
            found = self._distance(self._model, self._data, mine[i], yours[j], max(best, 1e-3), None)
            best = min(best, found)
        return float(best)

    def _near(self, a: str, b: str, far: float) -> Iterator[tuple[int, int, float]]:
        """Yield pairs of parts whose bounds are closer than ``far``, nearest first, with a lower bound of their
        distance.
        """
        if not len(self._own[a][0]) or not len(self._own[b][0]):
            return
        (middle_a, turn_a, size_a), (middle_b, turn_b, size_b) = self._posed(a), self._posed(b)
        off = middle_b[None] - middle_a[:, None]
        between = np.sqrt((off * off).sum(axis=2)) - size_a[:, None] - size_b
        i, j = np.nonzero(between < far)
        if not len(i):
            return
        off = off[i, j]
        bound = np.maximum(
            _beyond(off, turn_a[i], self._boxes[a][1][i]) - size_b[j],
            _beyond(off, turn_b[j], self._boxes[b][1][j]) - size_a[i],
        )
        kept = np.flatnonzero(bound < far)
        for k in kept[np.argsort(bound[kept], kind="stable")]:
            yield int(i[k]), int(j[k]), float(bound[k])


def _bare(link: Link) -> Link:
    """The link reduced to its shape: with one surface material for all, the model needs no explicit contact pairs."""
    colliders = tuple(
        replace(c, friction=1.0, restitution=0.0, torsional_friction=0.0, rolling_friction=0.0) for c in link.colliders
    )
    return replace(link, visuals=(), colliders=colliders)


def _beyond(off: Array, turn: Array, half: Array) -> Array:
    """Distance of points at ``off`` from the box centers to the outside of the boxes [m], (k,)."""
    outside = np.maximum(np.abs(np.einsum("kij,ki->kj", turn, off)) - half, 0.0)
    return np.asarray(np.sqrt((outside * outside).sum(axis=1)))
