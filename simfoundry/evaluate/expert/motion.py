"""Motion planning for a single arm: straight-line motions of the hand, and collision-free paths around obstacles."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from simfoundry.backends.mjcf.bodies import free_joint_name
from simfoundry.geometry.frames import Array, Pose
from simfoundry.robots.arm import Arm, Jaws
from simfoundry.scene.kinematics import trees
from simfoundry.scene.model import Scene
from simfoundry.scene.robot import mujoco_model
from simfoundry.scene.state import SceneState
from simfoundry.worlds.mujoco_world import MujocoWorld

# A sequence of arm configurations, each with shape (n,) [rad or m].
Path = list[Array]

# Position step between the configurations of a straight line [m].
LINE = 0.015

# Rotation step between the configurations of a straight line [rad].
TURN = 0.1

# Maximum joint step [rad] between two configurations of a line; a larger step means that the inverse kinematics jumped
# to another branch.
LEAP = 0.35

# Joint step at which paths are checked for collisions [rad].
FINE = 0.08

# Minimum clearance for motions in free space [m].
GAP = 0.004

# Preferred clearance [m] for motions in free space; joints lag behind their targets by different amounts, so the arm
# cuts corners.
WIDE = 0.02

# Maximum number of configurations in a search, and the step size of the search [rad].
NODES, STRIDE = 1500, 0.3


@dataclass(frozen=True, eq=False)
class Held:
    """An object that is held by a hand. ``X_HO`` is its pose in the hand frame."""

    name: str
    X_HO: Pose


class ArmPlanner:
    """A planner for one arm in its planning scene."""

    def __init__(self, cell: PlanningScene, arm: Arm, fingers: Jaws, rng: np.random.Generator) -> None:
        self.cell, self.arm, self.jaws, self.rng = cell, arm, fingers, rng
        self.name = arm.robot.name

    def clear(
        self, q: Array, share: float, held: Held | None = None, gap: float = GAP, ignore: Iterable[str] = ()
    ) -> bool:
        """Return True if a configuration of the arm is free of collisions.

        Args:
            q: The configuration of the arm.
            share: The fraction by which the gripper is closed.
            held: The object in the hand, if any.
            gap: The required clearance [m].
            ignore: Names of objects with which collisions are allowed.
        """
        self.cell.pose(self.name, q, share)
        moving = [self.name]
        if held is not None:
            self.cell.put(held.name, self.arm.hand(q) @ held.X_HO)
            moving.append(held.name)
        return self.cell.clash(moving, gap, ignore) is None

    def line(
        self, q: Array, X_WH: Pose, share: float, held: Held | None = None, gap: float = 0.0, ignore: Iterable[str] = ()
    ) -> Path | None:
        """Return configurations that move the hand in a straight line, or None if the arm cannot follow the line.

        Args:
            q: The initial configuration.
            X_WH: The final pose of the hand.
            share: The fraction by which the gripper is closed.
            held: The object in the hand, if any.
            gap: The required clearance [m].
            ignore: Names of objects with which collisions are allowed.
        """
        start = self.arm.hand(q)
        count = max(1, int(np.ceil(max(float(np.linalg.norm(X_WH.p - start.p)) / LINE, start.angle_to(X_WH) / TURN))))
        path = [q]
        for k in range(1, count + 1):
            between = self.arm.solve(blend(start, X_WH, k / count), path[-1])
            leaps = between is None or np.abs(between - path[-1]).max() > LEAP
            if between is None or leaps or not self.clear(between, share, held, gap, ignore):
                return None
            path.append(between)
        return path

    def way(self, q: Array, goal: Array, share: float, held: Held | None = None) -> Path | None:
        """Return a path from ``q`` to ``goal`` around obstacles, or None if no path was found.

        If possible, the path keeps the preferred clearance.
        """
        for gap in (WIDE, GAP):
            free = partial(self.clear, share=share, held=held, gap=gap)
            if not free(goal):
                continue
            if _straight(q, goal, free):
                return [q, goal]
            found = _search(q, goal, free, self.arm.low, self.arm.high, self.rng)
            if found is not None:
                return _shortened(found, free, self.rng)
        return None


def blend(a: Pose, b: Pose, share: float) -> Pose:
    """Interpolate between two poses.

    The result is ``a`` if ``share`` is 0, and ``b`` if ``share`` is 1.
    """
    qb = b.q if float(a.q @ b.q) >= 0 else -b.q
    angle = float(np.arccos(np.clip(a.q @ qb, -1.0, 1.0)))
    turned = (np.sin((1 - share) * angle) * a.q + np.sin(share * angle) * qb) / np.sin(angle) if angle >= 1e-6 else b.q
    return Pose.of(a.p + share * (b.p - a.p), turned)


# Function that returns True if a configuration is free of collisions.
Free = Callable[[Array], bool]


def _straight(a: Array, b: Array, free: Free) -> bool:
    """Return True if all configurations on the straight line from ``a`` to ``b`` are free of collisions.

    Configuration ``a`` itself is not checked.
    """
    count = max(1, int(np.ceil(np.abs(b - a).max() / FINE)))
    return all(free(a + (b - a) * k / count) for k in range(1, count + 1))


class _Tree:
    """A tree of configurations that are connected by collision-free straight lines."""

    def __init__(self, root: Array) -> None:
        self.postures, self._parents = [root], [-1]

    def extend(self, toward: Array, free: Free) -> int | None:
        """Grow the tree by one step.

        Returns:
            The index of the new configuration, or None if the tree did not grow.
        """
        distance = np.abs(np.array(self.postures) - toward).max(axis=1)
        nearest = int(distance.argmin())
        if distance[nearest] < 1e-9:
            return None
        start = self.postures[nearest]
        step = start + (toward - start) * min(1.0, STRIDE / distance[nearest])
        if not _straight(start, step, free):
            return None
        self.postures.append(step)
        self._parents.append(nearest)
        return len(self.postures) - 1

    def path(self, k: int) -> Path:
        """Return the configurations from the k-th configuration to the root of the tree."""
        found = []
        while k >= 0:
            found.append(self.postures[k])
            k = self._parents[k]
        return found


def _search(start: Array, goal: Array, free: Free, low: Array, high: Array, rng: np.random.Generator) -> Path | None:
    """Search for a path with rapidly exploring random trees from both ends.

    The algorithm is RRT-Connect (Kuffner and LaValle, 2000).
    """
    trees = (_Tree(start), _Tree(goal))
    for k in range(NODES):
        side = k % 2
        tree, other = trees[side], trees[1 - side]
        # Sample between the two ends more often than elsewhere, because most paths pass through that region.
        mix = rng.uniform(size=len(start))
        near = start + mix * (goal - start) + rng.normal(scale=0.5, size=len(start))
        sample = np.clip(near, low, high) if rng.uniform() < 0.8 else rng.uniform(low, high)
        new = tree.extend(sample, free)
        if new is None:
            continue
        while (step := other.extend(tree.postures[new], free)) is not None:
            if np.abs(other.postures[step] - tree.postures[new]).max() < 1e-9:
                first, last = (new, step) if side == 0 else (step, new)
                return trees[0].path(first)[::-1] + trees[1].path(last)[1:]
    return None


def _shortened(path: Path, free: Free, rng: np.random.Generator) -> Path:
    """Remove unnecessary detours from a path."""
    for _ in range(40):
        if len(path) < 3:
            break
        i, j = sorted(int(k) for k in rng.choice(len(path), 2, replace=False))
        if j > i + 1 and _straight(path[i], path[j], free):
            path = path[: i + 1] + path[j:]
    return path


# Distance up to which collisions are detected [m].
FAR = 0.03


class PlanningScene:
    """The scene in MuJoCo, used for collision queries.

    A query changes the state of the scene, and :meth:`sync` restores a given state.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self._world = MujocoWorld(scene)
        self._model, self._data = self._world.model, self._world.data
        model = self._model
        self._natives = {r.name: native for r in scene.robots if (native := mujoco_model(r)) is not None}
        owners = {model.body(t.name).id: o.name for o in scene.objects for t in trees(o)}
        owners |= {model.body(name).id: name for name in self._natives}
        self._owner = np.array([owners.get(int(root), "") for root in model.body_rootid[model.geom_bodyid]])
        free = {o.name: free_joint_name(trees(o)[0]) for o in scene.objects if not o.fixed}
        self._free = {name: int(model.joint(joint).qposadr[0]) for name, joint in free.items()}
        model.geom_margin[:] = FAR / 2
        model.pair_margin[:] = FAR
        model.body_margin[:] = FAR / 2  # bodies that are farther apart are skipped
        self._hands = {name: self._hand(name) for name in self._natives}
        self._hand_geoms = {name: {int(g) for g in hand[1]} for name, hand in self._hands.items()}
        self._world.reset()
        self._collide()
        pairs = (sorted(int(g) for g in c.geom) for c in self._data.contact[: self._data.ncon])
        # Geoms of one robot that are close to each other initially, such as those of neighboring links.
        self._own = {(a, b) for a, b in pairs if self._owner[a] == self._owner[b]}

    def sync(self, state: SceneState, postures: Mapping[str, Array], grippers: Mapping[str, float]) -> None:
        """Set the scene to a state, including the arm configuration and gripper position of each robot."""
        self._world.reset(SceneState.of(state.poses, state.joints, state.motions))
        for name, q in postures.items():
            self.pose(name, q, grippers[name])

    def pose(self, robot: str, q: Array, share: float) -> None:
        """Set a robot's arm to a configuration and close its gripper by the fraction ``share``."""
        native = self._natives[robot]
        names = list(native.joints.values()) or list(self._world.robot(robot).joints)
        positions = dict(zip(names, q, strict=True))
        if native.gripper is not None:
            positions |= native.gripper.positions(share)
        for name, position in positions.items():
            self._data.qpos[self._model.joint(f"{robot}.{name}").qposadr[0]] = position

    def put(self, name: str, X_WO: Pose) -> None:
        """Set the pose of an object."""
        start = self._free[name]
        self._data.qpos[start : start + 7] = [*X_WO.p, *X_WO.q]

    def turn(self, joint: str, position: float) -> None:
        """Set a joint ``object.joint`` to a position [rad or m]."""
        self._data.qpos[self._model.joint(joint).qposadr[0]] = position

    def _collide(self) -> None:
        import mujoco

        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_collision(self._model, self._data)

    def hand_clash(self, robot: str, X_WH: Pose, held: str | None = None, gap: float = 0.0, ignore: str = "") -> bool:
        """Return True if a hand, or the object that it holds, is closer than ``gap`` [m] to anything else.

        The rest of the arm is ignored, so this test is much cheaper than planning a motion. The fingers stay in their
        current position.

        Args:
            robot: The robot to which the hand belongs.
            X_WH: The pose of the hand.
            held: The name of the object in the hand, if any.
            gap: The required clearance [m].
            ignore: The name of an object with which collisions are allowed.
        """
        import mujoco

        data = self._data
        mujoco.mj_kinematics(self._model, data)
        bodies, geoms, frame = self._hands[robot]
        link = Pose.of(data.xpos[bodies[0]], data.xquat[bodies[0]])
        moved = X_WH @ (link @ frame).inverse()
        turn = moved.rotation
        for points in (data.xpos, data.xipos):
            points[bodies] = points[bodies] @ turn.T + moved.p
        for turns in (data.xmat, data.ximat):
            turns[bodies] = (turn @ turns[bodies].reshape(-1, 3, 3)).reshape(-1, 9)
        data.geom_xpos[geoms] = data.geom_xpos[geoms] @ turn.T + moved.p
        data.geom_xmat[geoms] = (turn @ data.geom_xmat[geoms].reshape(-1, 3, 3)).reshape(-1, 9)
        mujoco.mj_collision(self._model, data)
        contact = data.contact
        for k in np.flatnonzero(contact.dist[: data.ncon] < max(gap, 0.0)):
            pair = [int(g) for g in contact.geom[k]]
            owners = {str(self._owner[g]) for g in pair}
            if len(owners) < 2 or ignore in owners or owners == {robot, held}:
                continue
            if held in owners and contact.dist[k] < 0.0:
                return True
            if held not in owners and any(g in self._hand_geoms[robot] for g in pair):
                return True
        return False

    def _hand(self, robot: str) -> tuple[NDArray[np.intp], NDArray[np.intp], Pose]:
        """Return the bodies and geoms of a hand, and the pose of the hand frame relative to the first body."""
        model, frame = self._model, self._natives[robot].frame("hand")
        bodies = self._below(model.body(f"{robot}.{frame.link}").id)
        return np.array(bodies), np.flatnonzero(np.isin(model.geom_bodyid, bodies)), frame.X_LF

    def _below(self, top: int) -> list[int]:
        """Return a body and all bodies that move with it."""
        bodies = [top]
        for body in range(top + 1, self._model.nbody):  # MuJoCo orders bodies depth first: parents precede children
            if int(self._model.body_parentid[body]) in bodies:
                bodies.append(body)
        return bodies

    def clash(self, moving: Iterable[str], gap: float = 0.0, ignore: Iterable[str] = ()) -> str | None:
        """Return the first body that is closer than ``gap`` [m] to one of the ``moving`` robots and objects, or None.

        Contacts among the moving bodies and contacts with ``ignore`` are not counted.
        """
        self._collide()
        mine = set(moving)
        passed = mine | set(ignore)
        contact = self._data.contact
        for k in np.flatnonzero(contact.dist[: self._data.ncon] < gap):
            a, b = (int(g) for g in contact.geom[k])
            first, second = self._owner[a], self._owner[b]
            if first == second:
                known = (min(a, b), max(a, b)) in self._own
                if first in self._natives and first in mine and not known and contact.dist[k] < 0:
                    return f"{first} itself"
            elif first in mine and second not in passed:
                return str(second)
            elif second in mine and first not in passed:
                return str(first)
        return None

    def hands_are_free(self, robots: Iterable[str], held: str = "", gap: float = FAR) -> bool:
        """Return True if hands, and the object that they hold, are at least ``gap`` [m] away from everything else.

        Args:
            robots: The robots to which the hands belong.
            held: The name of the object in the hands, or an empty string.
            gap: The required clearance [m], at most :data:`FAR`.
        """
        self._collide()
        mine, contact = set(robots), self._data.contact
        for k in np.flatnonzero(contact.dist[: self._data.ncon] < gap):
            pair = [int(g) for g in contact.geom[k]]
            for geom, other in (pair, pair[::-1]):
                owner = str(self._owner[geom])
                is_moving = owner == held or (owner in mine and geom in self._tips[owner])
                if is_moving and str(self._owner[other]) not in {*mine, held}:
                    return False
        return True

    @cached_property
    def _tips(self) -> Mapping[str, set[int]]:
        """The geoms that collide at the end of each robot: those of its hand, or of the closest link that has any."""
        model, found = self._model, {}
        felt = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
        for name, (bodies, _, _) in self._hands.items():
            body, geoms = int(bodies[0]), set[int]()
            while body and not geoms:
                within = np.isin(model.geom_bodyid, self._below(body))
                geoms, body = {int(g) for g in np.flatnonzero(within & felt)}, int(model.body_parentid[body])
            found[name] = geoms
        return found
