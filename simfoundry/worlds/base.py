"""The interfaces for worlds and their robots, which allow predicates, tasks and checks to run in any simulator.

This module also provides cameras, including those mounted on links, at their current poses and for any image size.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from simfoundry.errors import SimfoundryError
from simfoundry.geometry.frames import Array, Pose
from simfoundry.render.gl import RenderError
from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.model import Camera, Joint, MountedCamera, Scene, SceneObject
from simfoundry.scene.object_shapes import bounds
from simfoundry.scene.state import SceneState
from simfoundry.spec.models.base import MAX_IMAGE_SIDE

if TYPE_CHECKING:
    from simfoundry.predicates import Judge, Verdict


class WorldRobot(Protocol):
    """A robot in a world. Targets persist until they are changed. The world's ``step`` method advances the motion."""

    @property
    def joints(self) -> tuple[str, ...]:
        """The ordered names of the arm's joints, as used in the scene."""

    def positions(self) -> dict[str, float]:
        """Return the positions of the arm's joints [rad or m]."""

    def limits(self) -> dict[str, tuple[float, float]]:
        """Return the position limits of the arm's joints [rad or m], which are infinite for joints without limits."""

    def set_targets(self, targets: Mapping[str, float]) -> None:
        """Set the target positions of arm joints [rad or m], clipped to their limits.

        All joints that are not listed keep their targets.

        Raises:
            KeyError: If the robot has no such joint.
        """

    def gripper(self) -> float:
        """Return how far the gripper is closed, from 0 (open) to 1 (closed).

        The result is always 0 without a gripper.
        """

    def set_gripper(self, closed: float) -> None:
        """Set the gripper target, from 0 (open) to 1 (closed). Values outside this range are clipped."""

    def frame(self, name: str) -> Pose:
        """Return the world pose of the frame ``hand`` or ``base``, or of a link given by its name in the model."""


# An sRGB color image, shape (h, w, 3).
Image = NDArray[np.uint8]

# Maximum gap between surfaces in contact [m], regardless of the engine's contact margin.
CONTACT_GAP = 1e-3


@dataclass(frozen=True, eq=False)
class Contact:
    """A contact point between two objects.

    ``depth`` [m] is positive for penetration and negative for a gap, which is at most :data:`CONTACT_GAP`. ``normal``
    is the unit vector from ``a`` toward ``b``, and ``position`` is the contact point [m]. Both are in the world frame
    and have shape (3,).
    """

    a: str
    b: str
    depth: float
    normal: Array
    position: Array


class ClosedWorldError(SimfoundryError):
    """Raised if a world is used after it was closed."""

    def __init__(self, scene: Scene) -> None:
        super().__init__(f"the world of `{scene.name}` is closed; open the scene again")


class World(Protocol):
    """A simulator that runs one scene. Use a world as a context manager, or call :meth:`close` when done.

    Simulators derive from this class, which evaluates conditions in the same way for all of them. After a world is
    closed, its methods raise :class:`ClosedWorldError`.
    """

    scene: Scene

    @property
    def timestep(self) -> float:
        """The time step [s]."""

    def reset(self, state: SceneState | None = None) -> None:
        """Reset to ``state``, or to the scene's initial state, with zero velocities.

        Values that are missing from ``state`` are taken from the scene. Velocities in ``state`` are ignored. Robots
        hold their positions.

        Raises:
            KeyError: If ``state`` contains names that are not in the scene.
        """

    def step(self, n: int = 1) -> None:
        """Advance the simulation by ``n`` time steps."""

    def push(self, link: str, force: Array, point: Array) -> None:
        """Apply a force during the next call of :meth:`step`. Several forces on one link add up.

        Args:
            link: A link of an object: ``cabinet.drawer``, or ``cabinet`` for its root.
            force: The force in the world frame [N], shape (3,).
            point: The point in the world frame on which it acts [m], shape (3,). It does not move with the link.

        Raises:
            KeyError: If there is no such link.
        """

    def halt(self) -> None:
        """Set all velocities to zero without changing poses or positions."""

    def state(self) -> SceneState:
        """Return the poses and speeds of all objects and the positions of all joints, including robot joints."""

    def judge(self, condition: Any) -> Verdict:
        """Evaluate a condition, such as ``"OnTop(cup, desk)"``, in the current state."""
        return self._judge(condition, self.state())

    @cached_property
    def _judge(self) -> Judge:
        from simfoundry.predicates import Judge

        return Judge(self.scene)

    def contacts(self) -> list[Contact]:
        """Return the current contacts between different objects and robots."""

    def robot(self, name: str) -> WorldRobot:
        """Return the robot called ``name``.

        Raises:
            KeyError: If there is no such robot. The message lists the valid names.
        """

    def render(self, camera: str, width: int, height: int) -> Image:
        """Render the view from a camera in the scene, including robots, without changing the state.

        The camera image is scaled uniformly, and cropped around its center if the aspect ratio differs.

        Returns:
            An sRGB image, uint8, shape (height, width, 3).

        Raises:
            KeyError: If the camera is unknown. The message lists the valid names.
            RenderError: If rendering is not available, or if the width or height is out of range.
        """

    def depth_and_mask(self, camera: str, width: int, height: int) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
        """Return the depth and the visible instance at each pixel of the image that :meth:`render` would return.

        Returns:
            The depth along the optical axis [m], and the index in :func:`instances` plus 1, both of shape (height,
            width). Both are 0 where nothing is visible.

        Raises:
            KeyError: If the camera is unknown. The message lists the valid names.
            RenderError: If rendering is not available, or if the width or height is out of range.
        """

    def trouble(self) -> str:
        """Return the reason why the simulation since the last reset is invalid, or an empty string if it is valid."""

    def close(self) -> None:
        """Release the simulator."""

    def __enter__(self) -> Self:
        """Return the world."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the world."""
        self.close()


def instances(scene: Scene) -> tuple[str, ...]:
    """Return the names that the values of a mask stand for, in order: the scene's objects, followed by its robots."""
    return (*(item.name for item in scene.objects), *(robot.name for robot in scene.robots))


def complete_state(scene: Scene, state: SceneState | None) -> SceneState:
    """Complete ``state`` with the scene's own values.

    The position of a mimic joint is computed from its leader, unless ``state`` contains it.

    Raises:
        KeyError: If ``state`` contains names that are not in the scene.
    """
    initial = SceneState.initial(scene)
    if state is None:
        return initial
    _check_known("object", state.poses, initial.poses)
    _check_known("joint", state.joints, initial.joints)
    _check_known("ball or free joint", state.motions, initial.motions)
    joints = {**initial.joints, **state.joints}
    for item in scene.objects:
        by_name = {joint.name: joint for joint in item.joints}
        for joint in item.joints:
            name = f"{item.name}.{joint.name}"
            if joint.mimic is not None and name not in state.joints:
                joints[name] = _led(item.name, joint, by_name, joints)
    motions = {**initial.motions, **state.motions}
    return SceneState.of({**initial.poses, **state.poses}, joints, motions, state.robots)


def _led(owner: str, joint: Joint, by_name: Mapping[str, Joint], joints: Mapping[str, float]) -> float:
    """Compute the position [rad or m] of a mimic joint from the position of the first leader in its chain."""
    if joint.mimic is None:
        return joints[f"{owner}.{joint.name}"]
    return joint.mimic.position(_led(owner, by_name[joint.mimic.joint], by_name, joints))


def _check_known(kind: str, given: Mapping[str, object], known: Mapping[str, object]) -> None:
    unknown = sorted(set(given) - set(known))
    if unknown:
        raise KeyError(f"the scene has no {kind} {unknown[0]!r}; available names: {', '.join(known) or 'none'}")


def camera_now(world: World, mounted: MountedCamera) -> Camera:
    """Return the camera at its current pose in the world."""
    scene = world.scene
    if any(robot.name == mounted.carrier for robot in scene.robots):
        robot = scene.robot(mounted.carrier)
        X_WL = world.robot(mounted.carrier).frame(mounted.link) if mounted.link else robot.X_WB
    else:
        item = scene.object(mounted.carrier)
        state = world.state()
        X_OL = link_poses(item, state.of_object(item))[mounted.link or item.root.name]
        X_WL = state.poses[item.name] @ X_OL
    return replace(mounted.camera, X_WC=X_WL @ mounted.camera.X_WC)


def camera_of(world: World, name: str, width: int, height: int) -> Camera:
    """Return the camera called ``name`` at its current pose and for the given image size.

    Raises:
        KeyError: If the camera is unknown. The message lists the valid names.
        RenderError: If the width or height is not between 1 and :data:`MAX_IMAGE_SIDE`.
    """
    if not (1 <= width <= MAX_IMAGE_SIDE and 1 <= height <= MAX_IMAGE_SIDE):
        raise RenderError(f"an image has 1 to {MAX_IMAGE_SIDE} pixels per side, but {width} x {height} were requested")
    for camera in world.scene.cameras:
        if camera.name == name:
            return resized(camera, width, height)
    for mounted in world.scene.mounted:
        if mounted.camera.name == name:
            return resized(camera_now(world, mounted), width, height)
    known = [c.name for c in world.scene.cameras] + [m.camera.name for m in world.scene.mounted]
    raise KeyError(f"no camera {name!r}; available cameras: {', '.join(known) or 'none'}")


def resized(camera: Camera, width: int, height: int) -> Camera:
    """Return the camera with ``width`` x ``height`` pixels, scaled uniformly and cropped if the aspect ratio differs.

    The new camera's image equals the original image, scaled to cover the new size and then cropped equally on both
    sides.
    """
    scale = max(width / camera.width, height / camera.height)
    off_x, off_y = (camera.width * scale - width) / 2, (camera.height * scale - height) / 2
    # Pixel centers have integer coordinates, so the edge of the image is at -0.5.
    cx, cy = (camera.cx + 0.5) * scale - 0.5 - off_x, (camera.cy + 0.5) * scale - 0.5 - off_y
    return replace(camera, width=width, height=height, fx=camera.fx * scale, fy=camera.fy * scale, cx=cx, cy=cy)


def reach(item: SceneObject) -> float:
    """Return the distance [m] from an object's frame to the farthest corner of its bounding box."""
    low, high = bounds(item)
    return float(np.linalg.norm(np.maximum(np.abs(low), np.abs(high))))
