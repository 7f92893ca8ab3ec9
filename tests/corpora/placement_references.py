"""What simulators and ray casts say of a state, without any of our predicates: contact forces, and BEHAVIOR's rays."""

from __future__ import annotations

import math
from collections import defaultdict
from typing import Any, NamedTuple, Protocol

import numpy as np

from simfoundry.geometry.frames import Array
from simfoundry.worlds.mujoco_world import MujocoWorld
from simfoundry.worlds.pybullet_world import PybulletWorld

Pushes = dict[tuple[str, str], Array]
"""Mean force of the second object on the first [N], shape (3,), in the world."""

SECONDS = 1.0
"""How long the simulators run."""

MEAN = 0.1
"""Forces are means over so long [s] at the end: PyBullet's change from step to step."""

CARRIED_SHARE = 0.1
"""What carries a thing pushes it up by more than this share of its weight: less is the noise of a touch."""

CARRIED_DEG = 45.0
"""... and within this of straight up [deg], as Isaac Lab-Arena asks."""


class Engine(Protocol):
    """A simulator whose contact forces are read."""

    world: Any

    def pushes(self) -> Pushes:
        """Forces between objects, now."""
        ...


class MujocoForces:
    """MuJoCo's contact forces."""

    def __init__(self, world: MujocoWorld) -> None:
        import mujoco

        self.world, self._mujoco = world, mujoco

    def pushes(self) -> Pushes:
        """Forces between objects, now."""
        model, data = self.world.model, self.world.data
        found: Pushes = defaultdict(lambda: np.zeros(3))
        force = np.zeros(6)
        for k in range(data.ncon):
            contact = data.contact[k]
            self._mujoco.mj_contactForce(model, data, k, force)
            # The frame's first row points from the first geom to the second: so is the second pushed.
            push = contact.frame.reshape(3, 3).T @ force[:3]
            a, b = (model.body(model.body_rootid[model.geom_bodyid[g]]).name for g in contact.geom)
            found[b, a] = found[b, a] + push
            found[a, b] = found[a, b] - push
        return found


class PybulletForces:
    """PyBullet's contact forces."""

    def __init__(self, world: PybulletWorld) -> None:
        import pybullet

        self.world, self._bullet = world, pybullet
        self._names = {body: name for name, body in world.bodies.items()}

    def pushes(self) -> Pushes:
        """Forces between objects, now."""
        found: Pushes = defaultdict(lambda: np.zeros(3))
        for point in self._bullet.getContactPoints(physicsClientId=self.world.client):
            a, b = self._names[point[1]], self._names[point[2]]
            push = point[9] * np.array(point[7])  # the normal points from the second to the first
            push = push + point[10] * np.array(point[11]) + point[12] * np.array(point[13])
            found[a, b] = found[a, b] + push
            found[b, a] = found[b, a] - push
        return found


def run(engine: Engine) -> Pushes:
    """Simulate :data:`SECONDS` and return the mean forces at the end."""
    world = engine.world
    steps = round(SECONDS / world.timestep)
    last = max(1, round(MEAN / world.timestep))
    world.step(steps - last)
    total: Pushes = defaultdict(lambda: np.zeros(3))
    for _ in range(last):
        world.step(1)
        for pair, push in engine.pushes().items():
            total[pair] = total[pair] + push / last
    return dict(total)


def carriers(pushes: Pushes, weights: dict[str, float]) -> dict[str, set[str]]:
    """By object: what carries it. ``weights`` [N] are those of the objects that can move."""
    found: dict[str, set[str]] = {name: set() for name in weights}
    for (a, b), push in pushes.items():
        steep = push[2] >= math.cos(math.radians(CARRIED_DEG)) * float(np.linalg.norm(push))
        if a in found and steep and push[2] > CARRIED_SHARE * weights[a]:
            found[a].add(b)
    return found


def carried_by(name: str, other: str, pushes: Pushes, weights: dict[str, float]) -> bool:
    """Whether the weight of one object goes into another, directly or through what lies between."""
    seen, todo = set[str](), [name]
    while todo:
        one = todo.pop()
        for (a, b), push in pushes.items():
            if a == one and b not in seen and push[2] > 0.1 * weights.get(one, math.inf):
                if b == other:
                    return True
                seen.add(b)
                if b in weights:
                    todo.append(b)
    return False


# -- rays --------------------------------------------------------------------------------------------------------------

PLANES = 5
"""Pairs of level axes that BEHAVIOR tries."""

FAR = 5.0
"""How far BEHAVIOR's rays reach [m]."""


class Adjacency(NamedTuple):
    """Whether another object is met by the rays of one: up, down, and along pairs of level axes, both ways of each."""

    up: bool
    down: bool
    level: tuple[tuple[tuple[bool, bool], tuple[bool, bool]], ...]
    within: bool


class Rays:
    """BEHAVIOR's adjacencies by MuJoCo's ray casts at the colliders of one state."""

    def __init__(self, world: MujocoWorld) -> None:
        import mujoco

        self._mujoco, self._model, self._data = mujoco, world.model, world.data
        mujoco.mj_forward(world.model, world.data)
        model = world.model
        self._geoms: dict[str, list[int]] = defaultdict(list)
        for g in range(model.ngeom):
            if model.geom_contype[g] or model.geom_conaffinity[g]:
                self._geoms[model.body(model.body_rootid[model.geom_bodyid[g]]).name].append(g)
        self.bounds = {name: self._bound(geoms) for name, geoms in self._geoms.items()}

    def _bound(self, geoms: list[int]) -> tuple[Array, Array]:
        ends = np.array([self._ends(g) for g in geoms])
        return ends[:, 0].min(axis=0), ends[:, 1].max(axis=0)

    def _ends(self, g: int) -> Array:
        """The lower and the upper corner of a geom's bounds [m], (2, 3)."""
        points, round_ = self._core(g)
        return np.stack([points.min(axis=0) - round_, points.max(axis=0) + round_])

    def _core(self, g: int) -> tuple[Array, Array]:
        """Points, and how far a geom reaches beyond them along the world's axes [m], (3,)."""
        model, kinds = self._model, self._mujoco.mjtGeom
        p, R = self._data.geom_xpos[g], self._data.geom_xmat[g].reshape(3, 3)
        kind, size = model.geom_type[g], model.geom_size[g]
        if kind == kinds.mjGEOM_MESH:
            mesh = model.geom_dataid[g]
            first = model.mesh_vertadr[mesh]
            return p + model.mesh_vert[first : first + model.mesh_vertnum[mesh]] @ R.T, np.zeros(3)
        if kind == kinds.mjGEOM_BOX:
            signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
            return p + (signs * size) @ R.T, np.zeros(3)
        if kind == kinds.mjGEOM_SPHERE:
            return p[None], np.full(3, size[0])
        ends = np.stack([p - size[1] * R[:, 2], p + size[1] * R[:, 2]])
        if kind == kinds.mjGEOM_CAPSULE:
            return ends, np.full(3, size[0])
        if kind == kinds.mjGEOM_CYLINDER:
            return ends, size[0] * np.sqrt(np.maximum(0, 1 - R[:, 2] ** 2))
        raise ValueError(f"no bounds of geoms of type {kind}")

    def _hit(self, geoms: list[int], start: Array, way: Array) -> float:
        """How far a ray goes to geoms [m]; -1 where it misses."""
        model = self._model
        model.geom_group[:] = 0
        model.geom_group[geoms] = 5
        only = np.array([0, 0, 0, 0, 0, 1], dtype=np.uint8)
        found = np.zeros(1, dtype=np.int32)
        far = self._mujoco.mj_ray(model, self._data, start, way, only, 1, -1, found)
        return float(far) if 0 <= far <= FAR else -1.0

    def _around(self, name: str, point: Array) -> list[int]:
        """The geoms of an object that a point [m] is not in."""
        up, out = np.array([0.0, 0.0, 1.0]), []
        for g in self._geoms[name]:
            low, high = self._ends(g)
            within = (low <= point).all() and (point <= high).all()
            if not within or min(self._hit([g], point, up), self._hit([g], point, -up)) < 0:
                out.append(g)
        return out

    def middle(self, name: str) -> Array:
        """The middle of an object's bounds [m]."""
        low, high = self.bounds[name]
        return np.asarray((low + high) / 2)

    def adjacency(self, a: str, b: str) -> Adjacency:
        """What the rays of ``a`` meet of ``b``: level ones from its middle, upright ones from its own surface."""
        low, high = self.bounds[a]
        middle = (low + high) / 2
        met = []
        for sign in (1.0, -1.0):
            way = np.array([0.0, 0.0, sign])
            edge = middle + way * ((high - low)[2] / 2 + 0.01)
            own = self._hit(self._geoms[a], edge, -way)  # BEHAVIOR shoots from where its own surface is met from beyond
            start = edge - way * own if 0 <= own <= (high - low)[2] + 0.01 else middle
            met.append(self._hit(self._geoms[b], start, way) >= 0)
        level = []
        walls = self._around(b, middle)  # what a point is in is not beside it
        for angle in np.linspace(0, math.pi / 2, PLANES):
            first = np.array([math.cos(angle), math.sin(angle), 0.0])
            second = np.array([-math.sin(angle), math.cos(angle), 0.0])
            level.append(
                tuple((self._hit(walls, middle, w) >= 0, self._hit(walls, middle, -w) >= 0) for w in (first, second))
            )
        low_b, high_b = self.bounds[b]
        within = bool((middle >= low_b).all() and (middle <= high_b).all())
        return Adjacency(met[0], met[1], tuple(level), within)  # type: ignore[arg-type]


def is_under(seen: Adjacency) -> bool:
    """BEHAVIOR's Under: a ray up meets the other, and a ray down does not."""
    return seen.up and not seen.down


def is_above(seen: Adjacency) -> bool:
    """The mirror image of BEHAVIOR's Under."""
    return seen.down and not seen.up


def is_enclosed(seen: Adjacency) -> bool:
    """BEHAVIOR's Inside: the other is on both sides along two of three axes at right angles."""
    if not seen.within:
        return False
    both = [tuple(all(pair) for pair in plane) for plane in seen.level]
    if seen.up and seen.down:
        return any(any(plane) for plane in both)
    return any(all(plane) for plane in both)


def is_inside(seen: Adjacency) -> bool:
    """BEHAVIOR's Inside of what has the other beneath it.

    Without that the lower of two nested bowls would be inside of the upper, and a rod in the cup turned over it.
    """
    return seen.down and is_enclosed(seen)
