"""What the tests of places share: distances as others compute them, and shapes to place."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from hypothesis import strategies as st

from simfoundry.geometry.frames import Array, Pose, quat_from_rpy
from simfoundry.geometry.shapes import Capsule, Cylinder, Mesh, Sphere, tessellate
from simfoundry.scene.model import SceneObject
from simfoundry.scene.place import solve
from simfoundry.spec.models.scene import Place
from simfoundry.worlds.mujoco_world import MujocoWorld
from tests.scenes import box, pose, scene_of, solid

ROUNDING = 1e-6
"""Positions are solved to this [m]."""

FLAT = (0.0, 0.0, 0.0)
CUBE = box(0.1, 0.1, 0.1)
DESK = solid("desk", box(1.4, 1.0, 0.04), pose(0.4, 0.1, -0.02), fixed=True)

SIDE = st.floats(0.01, 0.1)
SHAPES = st.one_of(
    st.builds(lambda a, b, c: box(a, b, c), SIDE, SIDE, SIDE),
    st.builds(Sphere, SIDE),
    st.builds(Cylinder, SIDE, SIDE),
    st.builds(Capsule, SIDE, SIDE),
)
ANGLE = st.floats(-180.0, 180.0).map(lambda angle: round(angle, 3))
TILT = st.one_of(st.just(FLAT), st.tuples(st.just(0.0), st.just(0.0), ANGLE), st.tuples(ANGLE, ANGLE, ANGLE))


def rotation(degrees: tuple[float, float, float]) -> Array:
    """Wxyz quaternion of roll, pitch and yaw in degrees."""
    return quat_from_rpy(*(math.radians(v) for v in degrees))


def put(item: SceneObject, place: Place, *others: SceneObject, viewer: Pose | None = None) -> SceneObject:
    """The item at its place among the others; raises :class:`PlaceError`."""
    return replace(item, X_WO=solve(item, place, {other.name: other for other in others}, viewer))


def meshed(name: str, mesh: Mesh, X_WO: Pose) -> SceneObject:
    """An object whose one collider is a convex mesh."""
    item = solid(name, box(0.02, 0.02, 0.02), X_WO)
    link = item.links[0]
    return replace(item, links=(replace(link, colliders=(replace(link.colliders[0], geometry=mesh),)),))


def surface(item: SceneObject) -> Array:
    """Many points of the first collider in the world, shape (n, 3)."""
    return item.X_WO.apply(tessellate(item.links[0].colliders[0].geometry, 240).vertices)


def distance(a: SceneObject, b: SceneObject) -> float:
    """The smallest distance [m] between colliders of two objects, negative where they meet, as MuJoCo computes it."""
    import mujoco

    world = MujocoWorld(scene_of(replace(a, fixed=True), replace(b, fixed=True)))
    world.model.opt.ccd_tolerance = 1e-9
    root = {name: world.model.body(name).id for name in (a.name, b.name)}
    touching = [g for g in range(world.model.ngeom) if world.model.geom_contype[g]]
    of = {n: [g for g in touching if _root(world, g) == i] for n, i in root.items()}
    found = [
        mujoco.mj_geomDistance(world.model, world.data, g, h, 1.0, np.zeros(6)) for g in of[a.name] for h in of[b.name]
    ]
    return float(min(found))


def _root(world: MujocoWorld, geom: int) -> int:
    body = int(world.model.geom_bodyid[geom])
    while world.model.body_parentid[body] != 0:
        body = int(world.model.body_parentid[body])
    return body


def vertical_gap(a: SceneObject, b: SceneObject) -> float:
    """How far ``a`` can be lowered before it meets ``b`` [m], by a linear program over their corners."""
    from scipy.optimize import linprog

    corners = [o.X_WO.apply(tessellate(o.links[0].colliders[0].geometry).vertices) for o in (a, b)]
    n, m = map(len, corners)
    level = np.concatenate([corners[0][:, :2].T, -corners[1][:, :2].T], axis=1)
    sums = np.array([[1.0] * n + [0.0] * m, [0.0] * n + [1.0] * m])
    height = np.concatenate([corners[0][:, 2], -corners[1][:, 2]])
    found = linprog(height, A_eq=np.concatenate([level, sums]), b_eq=[0, 0, 1, 1], bounds=(0, None))
    return float(found.fun)
