"""A scene in MuJoCo."""

from __future__ import annotations

from types import TracebackType
from typing import TYPE_CHECKING, Self

import numpy as np

from simfoundry.backends.mjcf import compile_mjcf
from simfoundry.backends.robots import mujoco_model
from simfoundry.errors import MissingEngineError
from simfoundry.scene.frames import Array, Pose, frozen_array
from simfoundry.scene.model import JointType, Scene, SceneObject
from simfoundry.scene.state import SceneState
from simfoundry.worlds.base import CONTACT_GAP, Contact, JointFacts, LinkFacts, complete_state
from simfoundry.worlds.mujoco_robot import MujocoRobotHandle
from simfoundry.worlds.robot import WorldRobot

if TYPE_CHECKING:
    import mujoco


class MujocoWorld:
    """A :class:`~simfoundry.worlds.World` over MuJoCo; ``model`` and ``data`` are MuJoCo's own."""

    def __init__(self, scene: Scene) -> None:
        try:
            import mujoco
        except ImportError as error:
            raise MissingEngineError("MuJoCo is not installed; install it with `pip install mujoco`") from error
        self._mujoco = mujoco
        self.scene = scene
        files = compile_mjcf(scene).files
        assets = {path: data for path, data in files.items() if path.startswith("assets/")}
        self.model: mujoco.MjModel = mujoco.MjModel.from_xml_string(files["scene.xml"].decode(), assets)
        self.data: mujoco.MjData = mujoco.MjData(self.model)
        self._bodies = {item.name: self.model.body(item.name).id for item in scene.objects}
        carried = {self.model.body(robot.name).id: robot.name for robot in scene.robots if mujoco_model(robot)}
        self._objects = {body: name for name, body in self._bodies.items()} | carried
        joints = SceneState.initial(scene).joints
        self._qpos = {name: int(self.model.joint(name).qposadr[0]) for name in joints}
        self._free = {o.name: int(self.model.joint(o.name).qposadr[0]) for o in scene.objects if not o.fixed}
        self.reset()

    @property
    def timestep(self) -> float:
        """Seconds a step."""
        return float(self.model.opt.timestep)

    def reset(self, state: SceneState | None = None) -> None:
        """Go to ``state``, at rest; without one, to the state that the scene describes."""
        full = complete_state(self.scene, state)
        self._mujoco.mj_resetDataKeyframe(self.model, self.data, self.model.key("initial").id)
        for name, pose in full.poses.items():
            if name in self._free:
                start = self._free[name]
                self.data.qpos[start : start + 7] = [*pose.p, *pose.q]
            else:
                self.model.body_pos[self._bodies[name]] = pose.p
                self.model.body_quat[self._bodies[name]] = pose.q
        for name, position in full.joints.items():
            self.data.qpos[self._qpos[name]] = position
        self._mujoco.mj_forward(self.model, self.data)

    def step(self, n: int = 1) -> None:
        """Advance ``n`` steps."""
        if n > 0:
            self._mujoco.mj_step(self.model, self.data, nstep=n)

    def halt(self) -> None:
        """Set every velocity to zero; poses and positions stay."""
        self.data.qvel[:] = 0.0

    def state(self) -> SceneState:
        """Poses of all objects and positions of all joints, now."""
        poses = {item.name: self._object_pose(item) for item in self.scene.objects}
        return SceneState.of(poses, {name: float(self.data.qpos[at]) for name, at in self._qpos.items()})

    def contacts(self) -> list[Contact]:
        """Contacts between different objects, now."""
        self._mujoco.mj_forward(self.model, self.data)
        found = []
        for contact in self.data.contact[: self.data.ncon]:
            a, b = (self._objects[int(self.model.body_rootid[self.model.geom_bodyid[g]])] for g in contact.geom)
            if a != b and contact.dist <= CONTACT_GAP:
                normal, position = frozen_array(contact.frame[:3]), frozen_array(contact.pos)
                found.append(Contact(a, b, -float(contact.dist), normal, position))
        return found

    def read_back(self) -> dict[str, LinkFacts]:
        """Every link by its qualified name, as MuJoCo holds it."""
        self._mujoco.mj_forward(self.model, self.data)
        facts = {}
        for item in self.scene.objects:
            for link in item.links:
                name = item.qualified(link.name)
                geoms = [self.model.geom(f"{name}.{collider.name}").id for collider in link.colliders]
                friction = tuple(float(self.model.geom_friction[geom][0]) for geom in geoms)
                facts[name] = self._link_facts(self.model.body(name).id, friction)
        return facts

    def _link_facts(self, body: int, friction: tuple[float, ...]) -> LinkFacts:
        axes = Pose.of(q=self.model.body_iquat[body]).rotation
        return LinkFacts(
            mass=float(self.model.body_mass[body]),
            com=frozen_array(self.model.body_ipos[body]),
            inertia=frozen_array(axes @ np.diag(self.model.body_inertia[body]) @ axes.T),
            X_WL=Pose.of(self.data.xpos[body], self.data.xquat[body]),
            friction=friction,
        )

    def read_back_joints(self) -> dict[str, JointFacts]:
        """Every joint that moves by ``object.joint``, as MuJoCo holds it."""
        return {name: self._joint_facts(self.model.joint(name).id) for name in self._qpos}

    def _joint_facts(self, joint: int) -> JointFacts:
        model, dof = self.model, self.model.jnt_dofadr[joint]
        limited = bool(model.jnt_limited[joint])
        slides = model.jnt_type[joint] == self._mujoco.mjtJoint.mjJNT_SLIDE
        turns = JointType.REVOLUTE if limited else JointType.CONTINUOUS
        low, high = (float(v) for v in model.jnt_range[joint])
        axis: Array = frozen_array(model.jnt_axis[joint])
        return JointFacts(
            type=JointType.PRISMATIC if slides else turns,
            axis=axis,
            limits=(low, high) if limited else None,
            damping=float(np.ravel(model.dof_damping[dof])[0]),
            friction=float(model.dof_frictionloss[dof]),
            armature=float(model.dof_armature[dof]),
        )

    def robot(self, name: str) -> WorldRobot:
        """The robot called ``name``; a KeyError lists the names there are."""
        return MujocoRobotHandle(self.model, self.data, self.scene.robot(name))

    def _object_pose(self, item: SceneObject) -> Pose:
        # From qpos, not xpos: after a step, MuJoCo's body poses are still those before it.
        if item.name in self._free:
            start = self._free[item.name]
            return Pose.of(self.data.qpos[start : start + 3], self.data.qpos[start + 3 : start + 7])
        body = self._bodies[item.name]
        return Pose.of(self.model.body_pos[body], self.model.body_quat[body])

    def close(self) -> None:
        """Nothing to let go of: MuJoCo frees its memory with the object."""

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close."""
        self.close()
