"""The MuJoCo world."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from simfoundry.backends.mjcf import compile_mjcf, naming_scene
from simfoundry.backends.mjcf.bodies import free_joint_name
from simfoundry.backends.mjcf.contacts import exact_model
from simfoundry.errors import MissingEngineError
from simfoundry.geometry.frames import Array, Pose, frozen_array
from simfoundry.render.backdrop import splat_backdrop
from simfoundry.render.offscreen import MujocoRenderer
from simfoundry.scene.kinematics import free_motions, link_poses, trees
from simfoundry.scene.model import Camera, JointType, Scene, SceneObject
from simfoundry.scene.robot import Robot, mujoco_model
from simfoundry.scene.state import SceneState
from simfoundry.worlds.base import (
    CONTACT_GAP,
    ClosedWorldError,
    Contact,
    Image,
    World,
    WorldRobot,
    camera_of,
    complete_state,
    instances,
    reach,
)
from simfoundry.worlds.robot_state import check_robots, mjcf_rows, unknown_joint

if TYPE_CHECKING:
    import mujoco

# Maximum number of pixels per side of images rendered in quick mode, because policies render thousands of them.
SMALL = 640


class MujocoWorld(World):
    """A world in MuJoCo. ``model`` and ``data`` are MuJoCo's own objects."""

    def __init__(self, scene: Scene) -> None:
        try:
            import mujoco
        except ImportError as error:
            raise MissingEngineError("MuJoCo is not installed; install with `pip install mujoco`") from error
        self._mujoco = mujoco
        self.scene = scene
        # Native data may merge bodies that the scene has, and changes the rules for contacts.
        files = compile_mjcf(replace(scene, native=None)).files
        with naming_scene(scene.name):
            self.model: mujoco.MjModel = exact_model(files)
        self._data: mujoco.MjData | None = mujoco.MjData(self.model)
        self._bodies = {item.name: self.model.body(item.name).id for item in scene.objects}
        parts = [tree for item in scene.objects for tree in trees(item)]
        self._objects = {self.model.body(tree.name).id: tree.owner.name for tree in parts}
        self._objects |= {self.model.body(robot.name).id: robot.name for robot in scene.robots if mujoco_model(robot)}
        initial = SceneState.initial(scene)
        self._qpos = {name: int(self.model.joint(name).qposadr[0]) for name in (*initial.joints, *initial.motions)}
        free = {tree.name: free_joint_name(tree) for tree in parts if not tree.fixed}
        self._free = {name: int(self.model.joint(joint).qposadr[0]) for name, joint in free.items()}
        self._renderers: dict[bool, MujocoRenderer] = {}
        self._moving = [_Moving(self.model, item) for item in scene.objects if item.joints or not item.fixed]
        self._pushed = False
        self._arms = {robot.name: mjcf_rows(robot) for robot in scene.robots}
        self._arm_qpos = {
            name: [int(self.model.joint(f"{name}.{row.other}").qposadr[0]) for row in rows]
            for name, rows in self._arms.items()
        }
        self.reset()

    @property
    def data(self) -> mujoco.MjData:
        """MuJoCo's data, which the world updates in place."""
        if self._data is None:
            raise ClosedWorldError(self.scene)
        return self._data

    @property
    def timestep(self) -> float:
        """The time step [s]."""
        return float(self.model.opt.timestep)

    def reset(self, state: SceneState | None = None) -> None:
        """Reset to ``state``, or to the scene's initial state, with zero velocities."""
        full = complete_state(self.scene, state)
        check_robots(self.scene, self._arms, state)
        self._mujoco.mj_resetDataKeyframe(self.model, self.data, self.model.key("initial").id)
        for name, pose in full.poses.items():
            if name in self._free:
                self._put(self._free[name], pose)
            else:
                self.model.body_pos[self._bodies[name]] = pose.p
                self.model.body_quat[self._bodies[name]] = pose.q
        for name, position in full.joints.items():
            self.data.qpos[self._qpos[name]] = position
        for item in self.scene.objects:
            for joint in item.joints:
                name = f"{item.name}.{joint.name}"
                if joint.type is JointType.BALL:
                    self.data.qpos[self._qpos[name] : self._qpos[name] + 4] = full.motions[name].q
                elif joint.type is JointType.FREE:
                    X_OL = link_poses(item, full.of_object(item))
                    self._put(self._qpos[name], full.poses[item.name] @ X_OL[joint.child])
        for name, positions in full.robots.items():
            self._put_robot(name, positions)
        self._mujoco.mj_forward(self.model, self.data)

    def _put_robot(self, name: str, positions: Mapping[str, float]) -> None:
        """Set a robot's joint positions, and command its servos to hold them."""
        for row, at in zip(self._arms[name], self._arm_qpos[name], strict=True):
            if row.joint in positions:
                self.data.qpos[at] = positions[row.joint]
        arm = self.robot(name)
        arm.set_targets({n: q for n, q in arm.positions().items() if arm.is_driven(n)})
        arm.set_gripper(arm.gripper())

    def _put(self, start: int, pose: Pose) -> None:
        self.data.qpos[start : start + 7] = [*pose.p, *pose.q]

    def step(self, n: int = 1) -> None:
        """Advance the simulation by ``n`` time steps."""
        if n > 0:
            self._mujoco.mj_step(self.model, self.data, nstep=n)
            if self._pushed:
                self.data.xfrc_applied[:] = 0.0
                self._pushed = False

    def push(self, link: str, force: Array, point: Array) -> None:
        """Apply a force during the next call of :meth:`step`."""
        body = self.model.body(link).id
        self._mujoco.mj_kinematics(self.model, self.data)
        self._mujoco.mj_comPos(self.model, self.data)
        self.data.xfrc_applied[body, :3] += force
        self.data.xfrc_applied[body, 3:] += np.cross(point - self.data.xipos[body], force)
        self._pushed = True

    def halt(self) -> None:
        """Set all velocities to zero without changing poses or positions."""
        self.data.qvel[:] = 0.0

    def state(self) -> SceneState:
        """Return the poses and speeds of all objects and the positions of all joints, including robot joints."""
        poses = {item.name: self._object_pose(item) for item in self.scene.objects}
        joints: dict[str, float] = {}
        motions: dict[str, Pose] = {}
        for item in self.scene.objects:
            X_OT = dict[str, Pose]()
            for joint in (joint for joint in item.joints if joint.type is not JointType.FIXED):
                name = f"{item.name}.{joint.name}"
                start = self._qpos[name]
                if joint.has_axis:
                    joints[name] = float(self.data.qpos[start])
                elif joint.type is JointType.BALL:
                    motions[name] = Pose.of(q=self.data.qpos[start : start + 4])
                else:
                    X_OT[joint.child] = poses[item.name].inverse() @ self._free_pose(start)
            if X_OT:
                found = free_motions(item, SceneState(poses, joints, motions).of_object(item), X_OT)
                motions |= {f"{item.name}.{name}": motion for name, motion in found.items()}
        qpos, qvel = self.data.qpos, self.data.qvel
        robots = {
            name: dict(zip((row.joint for row in rows), qpos[self._arm_qpos[name]].tolist(), strict=True))
            for name, rows in self._arms.items()
            if rows
        }
        speeds = {moving.name: moving.speed(qvel) for moving in self._moving}
        return SceneState.of(poses, joints, motions, robots, speeds)

    def contacts(self) -> list[Contact]:
        """Return the current contacts between different objects and robots."""
        self._mujoco.mj_forward(self.model, self.data)
        found = []
        for contact in self.data.contact[: self.data.ncon]:
            a, b = (self._objects[int(self.model.body_rootid[self.model.geom_bodyid[g]])] for g in contact.geom)
            if a != b and contact.dist <= CONTACT_GAP:
                normal, position = frozen_array(contact.frame[:3]), frozen_array(contact.pos)
                found.append(Contact(a, b, -float(contact.dist), normal, position))
        return found

    def render(self, camera: str, width: int, height: int) -> Image:
        """Render the view from a camera in the scene.

        Returns:
            An sRGB image, uint8, shape (height, width, 3).
        """
        renderer, view = self._prepared(camera, width, height)
        return renderer.picture(self.data, view, splat_backdrop(self.scene, view))

    def depth_and_mask(self, camera: str, width: int, height: int) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
        """Return the depth [m] and the visible instance at each pixel, both of shape (height, width)."""
        renderer, view = self._prepared(camera, width, height)
        depth, geoms = renderer.depth(self.data, view), renderer.geoms(self.data, view)
        order = {name: k + 1 for k, name in enumerate(instances(self.scene))}
        roots = self.model.body_rootid[self.model.geom_bodyid]
        labels = np.array([0, *(order.get(self._objects.get(int(root), ""), 0) for root in roots)], dtype=np.int32)
        mask = labels[geoms]
        return np.where(mask > 0, depth, 0).astype(np.float32), mask

    def _prepared(self, camera: str, width: int, height: int) -> tuple[MujocoRenderer, Camera]:
        """Return a renderer and the camera at its pose, after updating the poses that are rendered."""
        view = camera_of(self, camera, width, height)
        renderer = self._renderer(width, height, quick=max(width, height) <= SMALL)
        # After a step, MuJoCo's geom poses are still those before the step.
        self._mujoco.mj_kinematics(self.model, self.data)
        self._mujoco.mj_comPos(self.model, self.data)
        self._mujoco.mj_camlight(self.model, self.data)
        return renderer, view

    def _renderer(self, width: int, height: int, quick: bool) -> MujocoRenderer:
        """Return the renderer for small images or the one for large images. Both support all sizes requested so far.

        Creating a renderer uploads all meshes and textures, which takes as long as rendering dozens of images. A new
        renderer therefore also supports the previous sizes. Otherwise, two alternating sizes would cause a new renderer
        to be created for every image.
        """
        known = self._renderers.get(quick)
        if known is not None and known.holds(width, height):
            return known
        if known is not None:
            width, height = max(width, known.size[0]), max(height, known.size[1])
            self._renderers.pop(quick).close()
        self._renderers[quick] = MujocoRenderer(self.model, width, height, quick=quick)
        return self._renderers[quick]

    def trouble(self) -> str:
        """Return the reason why the simulation since the last reset is invalid, or an empty string if it is valid."""
        warnings = self._mujoco.mjtWarning
        bad = (warnings.mjWARN_BADQPOS, warnings.mjWARN_BADQVEL, warnings.mjWARN_BADQACC)
        if any(self.data.warning[int(kind)].number for kind in bad):
            return "the simulation diverged: MuJoCo found infinite or huge values and reset the state"
        return ""

    def robot(self, name: str) -> MujocoRobotHandle:
        """Return the robot called ``name``.

        Raises:
            KeyError: If there is no such robot. The message lists the valid names.
        """
        return MujocoRobotHandle(self.model, self.data, self.scene.robot(name))

    def _object_pose(self, item: SceneObject) -> Pose:
        # Computed from qpos instead of xpos, because after a step, MuJoCo's body poses are still those before the step.
        if item.name in self._free:
            return self._free_pose(self._free[item.name])
        body = self._bodies[item.name]
        return Pose.of(self.model.body_pos[body], self.model.body_quat[body])

    def _free_pose(self, start: int) -> Pose:
        return Pose.of(self.data.qpos[start : start + 3], self.data.qpos[start + 3 : start + 7])

    def close(self) -> None:
        """Release the simulation data and the GL renderers. Repeated calls have no effect."""
        self._data = None
        while self._renderers:
            self._renderers.popitem()[1].close()


class _Moving:
    """The indices of a movable object's velocities.

    These are the first of the six indices of each free body, and the indices of the object's joints.
    """

    def __init__(self, model: mujoco.MjModel, item: SceneObject) -> None:
        self.name, self._reach = item.name, reach(item)
        free = [free_joint_name(tree) for tree in trees(item) if not tree.fixed]
        self._free = [int(model.joint(name).dofadr[0]) for name in free]
        self._turning: list[int] = []
        self._sliding: list[int] = []
        for joint in item.joints:
            if joint.type not in (JointType.FIXED, JointType.FREE):
                dof = int(model.joint(f"{item.name}.{joint.name}").dofadr[0])
                slides = joint.type is JointType.PRISMATIC
                (self._sliding if slides else self._turning).extend(range(dof, dof + (1 if joint.has_axis else 3)))

    def speed(self, qvel: Array) -> float:
        """Return an upper bound on the speed [m/s] of the object's fastest point."""
        fastest = 0.0
        for start in self._free:
            x, y, z, a, b, c = qvel[start : start + 6].tolist()
            fastest = max(fastest, math.hypot(x, y, z) + math.hypot(a, b, c) * self._reach)
        for dof in self._sliding:
            fastest += abs(float(qvel[dof]))
        for dof in self._turning:
            fastest += abs(float(qvel[dof])) * 2 * self._reach
        return fastest


class MujocoRobotHandle(WorldRobot):
    """A robot in MuJoCo, whose targets are set in ``data.ctrl``."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, robot: Robot) -> None:
        native = mujoco_model(robot)
        if native is None:
            raise KeyError(f"robot {robot.name!r} has no model in a format that MuJoCo supports")
        self._model, self._data, self._robot, self._native = model, data, robot, native
        self._joints = {name: model.joint(f"{robot.name}.{native.joints.get(name, name)}").id for name in self._names()}
        self._servos = {name: self._servo(joint) for name, joint in self._joints.items()}

    def _names(self) -> tuple[str, ...]:
        if self._native.joints:
            return tuple(self._native.joints)
        start = f"{self._robot.name}."
        every = (self._model.joint(k).name for k in range(self._model.njnt))
        return tuple(name.removeprefix(start) for name in every if name.startswith(start))

    def _servo(self, joint: int) -> int | None:
        """Return the index of a joint's actuator, or None if it has no actuator."""
        import mujoco

        direct = int(mujoco.mjtTrn.mjTRN_JOINT)
        for k in range(self._model.nu):
            if self._model.actuator_trntype[k] == direct and self._model.actuator_trnid[k][0] == joint:
                return k
        return None

    @property
    def joints(self) -> tuple[str, ...]:
        """The ordered names of the arm's joints, as used in the scene."""
        return tuple(self._joints)

    def positions(self) -> dict[str, float]:
        """Return the positions of the arm's joints [rad or m]."""
        return {name: self._position(joint) for name, joint in self._joints.items()}

    def _position(self, joint: int) -> float:
        return float(self._data.qpos[self._model.jnt_qposadr[joint]])

    def limits(self) -> dict[str, tuple[float, float]]:
        """Return the position limits of the arm's joints [rad or m], which are infinite for joints without limits."""
        found = {}
        for name, joint in self._joints.items():
            low, high = self._model.jnt_range[joint] if self._model.jnt_limited[joint] else (-np.inf, np.inf)
            found[name] = (float(low), float(high))
        return found

    def is_driven(self, name: str) -> bool:
        """Return True if an arm joint has an actuator."""
        return self._servos[name] is not None

    def set_targets(self, targets: Mapping[str, float]) -> None:
        """Set the target positions of arm joints [rad or m], clipped to their limits.

        Raises:
            KeyError: If a joint is unknown.
        """
        limits = self.limits()
        for name, target in targets.items():
            if name not in self._servos:
                raise unknown_joint(self._robot.name, name, self.joints)
            servo = self._servos[name]
            if servo is None:
                raise KeyError(f"joint {name!r} of robot {self._robot.name!r} has no actuator")
            # A servo with gain k applies the force k * ctrl + bias[1] * position and rests where the two terms cancel.
            gain, spring = self._model.actuator_gainprm[servo][0], self._model.actuator_biasprm[servo][1]
            low, high = limits[name]
            self._command(servo, min(max(target, low), high) * -spring / gain)

    def _command(self, servo: int, value: float) -> None:
        if self._model.actuator_ctrllimited[servo]:
            value = float(np.clip(value, *self._model.actuator_ctrlrange[servo]))
        self._data.ctrl[servo] = value

    def gripper(self) -> float:
        """Return how far the gripper is closed, from 0 (open) to 1 (closed)."""
        gripper = self._native.gripper
        if gripper is None:
            return 0.0
        first = self._model.joint(f"{self._robot.name}.{next(iter(gripper.joints))}").id
        return gripper.closed(self._position(first))

    def set_gripper(self, closed: float) -> None:
        """Set the gripper target, from 0 (open) to 1 (closed)."""
        gripper = self._native.gripper
        if gripper is None:
            return
        share = min(max(closed, 0.0), 1.0)
        for name, (start, end) in (gripper.command or gripper.joints).items():
            if gripper.command or name not in gripper.follow:  # mimic joints have no servo
                self._command(self._model.actuator(f"{self._robot.name}.{name}").id, start + share * (end - start))

    def frame(self, name: str) -> Pose:
        """Return the world pose of a frame, or of a link given by its name in the model."""
        import mujoco

        mujoco.mj_kinematics(self._model, self._data)
        frame = self._native.frame(name)
        body = self._model.body(f"{self._robot.name}.{frame.link}").id
        return Pose.of(self._data.xpos[body], self._data.xquat[body]) @ frame.X_LF
