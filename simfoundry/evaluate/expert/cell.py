"""A model of the scene to plan on: what would touch what, in postures that the world is not in."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from simfoundry.backends.mjcf.bodies import free_joint_name
from simfoundry.evaluate.expert.jaws import finger_positions
from simfoundry.geometry.frames import Array, Pose
from simfoundry.scene.model import Scene
from simfoundry.scene.robot import mujoco_model
from simfoundry.scene.state import SceneState
from simfoundry.scene.trees import trees
from simfoundry.worlds.mujoco_world import MujocoWorld

FAR = 0.03
"""How far apart things are when they are still looked at [m]."""


class Cell:
    """The scene in MuJoCo, without time. What is asked of it changes it; :meth:`sync` brings it back to a state."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self._world = MujocoWorld(scene)
        self._model, self._data = self._world.model, self._world.data
        model = self._model
        owners = {model.body(t.name).id: o.name for o in scene.objects for t in trees(o)}
        owners |= {model.body(r.name).id: r.name for r in scene.robots if mujoco_model(r) is not None}
        roots = model.body_rootid[model.geom_bodyid]
        self._owner = np.array([owners.get(int(root), "") for root in roots])
        self._robots = {r.name for r in scene.robots}
        self._free = {
            o.name: int(model.joint(free_joint_name(trees(o)[0])).qposadr[0]) for o in scene.objects if not o.fixed
        }
        model.geom_margin[:] = FAR / 2
        model.pair_margin[:] = FAR
        self._hands = {r.name: self._hand(r.name) for r in scene.robots if mujoco_model(r) is not None}
        self._hand_geoms = {name: {int(g) for g in hand[1]} for name, hand in self._hands.items()}
        self._own: set[tuple[int, int]] = set()
        self._own = self._touching_itself()

    def _touching_itself(self) -> set[tuple[int, int]]:
        """Pairs of geoms of one robot that are near each other at the start: neighbours in its build."""
        self._world.reset()
        self._collide()
        contacts = self._data.contact[: self._data.ncon]
        pairs = (tuple(sorted(int(g) for g in c.geom)) for c in contacts)
        return {(a, b) for a, b in pairs if self._owner[a] == self._owner[b]}

    def sync(self, state: SceneState, postures: Mapping[str, Array], grippers: Mapping[str, float]) -> None:
        """Go to a state, with each robot's arm and gripper where they are."""
        self._world.reset(SceneState.of(state.poses, state.joints, state.motions))
        for name, q in postures.items():
            self.pose(name, q, grippers[name])

    def pose(self, robot: str, q: Array, share: float) -> None:
        """Put a robot's arm into a posture, with its gripper closed by ``share``."""
        native = mujoco_model(self.scene.robot(robot))
        assert native is not None
        names = list(native.joints.values()) or list(self._world.robot(robot).joints)
        for name, position in zip(names, q, strict=True):
            self._set(f"{robot}.{name}", position)
        if native.gripper is not None:
            for name, position in finger_positions(native.gripper, share).items():
                self._set(f"{robot}.{name}", position)

    def _set(self, joint: str, position: float) -> None:
        self._data.qpos[self._model.joint(joint).qposadr[0]] = position

    def put(self, name: str, X_WO: Pose) -> None:
        """Put an object somewhere."""
        start = self._free[name]
        self._data.qpos[start : start + 7] = [*X_WO.p, *X_WO.q]

    def _collide(self) -> None:
        import mujoco

        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_collision(self._model, self._data)

    def hand_clash(self, robot: str, X_WH: Pose, held: str | None = None, gap: float = 0.0, ignore: str = "") -> bool:
        """Whether a hand without its arm, and what it holds, would come nearer to anything than ``gap`` [m].

        Much cheaper than to find out how the arm gets there. The fingers are as they were posed last.
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
        """Bodies and geoms of a hand, the one with the hand's frame first, and that frame in it."""
        native = mujoco_model(self.scene.robot(robot))
        assert native is not None
        model, frame = self._model, native.frame("hand")
        top = model.body(f"{robot}.{frame.link}").id
        bodies = [top]
        for body in range(top + 1, model.nbody):  # MuJoCo's order is depth first: a parent comes before its children
            if int(model.body_parentid[body]) in bodies:
                bodies.append(body)
        return np.array(bodies), np.flatnonzero(np.isin(model.geom_bodyid, bodies)), frame.X_LF

    def clash(self, moving: Iterable[str], gap: float = 0.0, ignore: Iterable[str] = ()) -> str | None:
        """What the robots and objects that are ``moving`` together come nearer to than ``gap`` [m]; None if nothing.

        What they touch of each other and of ``ignore`` does not count.
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
                if first in self._robots and first in mine and not known and contact.dist[k] < 0:
                    return f"{first} itself"
                continue
            if first in mine and second not in passed:
                return str(second)
            if second in mine and first not in passed:
                return str(first)
        return None
