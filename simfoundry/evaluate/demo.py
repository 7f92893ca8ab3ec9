"""The final step of the demo, which places an arm beside the captured table and has it perform a small task."""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import islice, product
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from simfoundry.assets.cache import Cache
from simfoundry.backends.robot_models.mujoco_robot import read_robot
from simfoundry.backends.robot_models.robot_object import as_object
from simfoundry.errors import OutputError
from simfoundry.evaluate.expert.candidates import down, grasps, places
from simfoundry.evaluate.expert.policy import ExpertPolicy
from simfoundry.evaluate.policies.base import Image
from simfoundry.evaluate.resets.starts import RolloutStart
from simfoundry.evaluate.rollouts.execution import Execution
from simfoundry.evaluate.rollouts.rollout import Rollout, rollout
from simfoundry.evaluate.task import Task, load_task
from simfoundry.geometry.frames import Array
from simfoundry.predicates import Judge, PredicateError, StateBatch
from simfoundry.render.gl import Engine, choose_engine
from simfoundry.render.montage import png_bytes, side_by_side
from simfoundry.render.raycast import raycast
from simfoundry.robots.arm import jaws
from simfoundry.runtime.extras import MissingExtraError, need_extra
from simfoundry.runtime.files import ensure_folder_replaceable, staged, write_atomically, write_files
from simfoundry.scene.lower import lower_file
from simfoundry.scene.model import Scene, SceneObject
from simfoundry.scene.object_shapes import solid, world_bounds
from simfoundry.scene.robot import Robot, lower_robot, mujoco_model
from simfoundry.scene.state import SceneState
from simfoundry.spec.models.robot import RobotSpec
from simfoundry.spec.models.robot_file import find_robot
from simfoundry.spec.models.signals import ActionSpace
from simfoundry.spec.project import Project, find_project, markers
from simfoundry.worlds import open_world
from simfoundry.worlds.base import World, camera_of
from simfoundry.worlds.rest import center_of_mass

# The robot that the demo uses; this arm does not need to be downloaded.
ARM = "demo_arm"

# The distances [m] from the base to the midpoint between object and target, in order of preference, and the minimum
# clearance [m] between the base and any object. The arm's foot has a radius of 0.09 m, and its elbow also needs space.
NEAR, APART = (0.50, 0.45, 0.55, 0.40, 0.60), 0.16

# The minimum distance [m] from the base for a grasp from above (measured: 0.28 m), and the safety margin [m] on the
# reach.
NEAREST, MARGIN = 0.30, 0.04

# Directions [deg] from the objects to the base, measured from the direction to the camera. Opposite the camera, the arm
# does not occlude anything.
SIDES = (180, 135, -135, 90, -90)

# The minimum distance [m] between a base on the table and the table's edge.
EDGE = 0.08

# The maximum number of tasks to try before giving up.
ATTEMPTS = 3

# The number of images in the strip, and the width and height of each image [px].
PICTURES, SIZE = 5, (400, 300)

# The names of the output files.
SCENE, TASK, STRIP, REPORT = "arm.scene.yaml", "arm.task.yaml", "strip.png", "report.json"

# The name of the camera that shows the arm performing its task.
CAMERA = "side"


@dataclass(frozen=True, eq=False)
class ArmDemo:
    """The result of the arm demo.

    Attributes:
        instruction: The instruction of the task.
        success: True if the goal held at the end.
        seconds: The duration of the arm's motion [s].
        reason: An explanation of the failure, or an empty string on success.
        task: The task document, or None if no suitable task was found.
        strip: The strip of images, or None if no suitable task was found.
    """

    instruction: str
    success: bool
    seconds: float
    reason: str
    task: Path | None = None
    strip: Path | None = None

    def to_json(self) -> dict[str, Any]:
        """Return the result as a plain mapping."""
        return {key: str(value) if isinstance(value, Path) else value for key, value in vars(self).items()}


@dataclass(frozen=True, eq=False)
class _Idea:
    """A candidate task and the pose of the arm that performs it.

    The base of the arm is at ``base`` on the ground [m] and faces the direction ``yaw`` [rad].
    """

    thing: str
    target: str
    inside: bool
    base: Array = field(default_factory=lambda: np.zeros(3))
    yaw: float = 0.0

    @property
    def instruction(self) -> str:
        names = [name.replace("_", " ") for name in (self.thing, self.target)]
        return f"Put the {names[0]} {'in' if self.inside else 'on'} the {names[1]}."

    @property
    def goal(self) -> str:
        return f"{'Inside' if self.inside else 'OnTop'}({self.thing}, {self.target})"


def demonstrate(scene_file: Path, out: Path, force: bool = False) -> ArmDemo:
    """Have an arm perform a small task in a scene, and write the resulting scene, task and images to a folder.

    Args:
        scene_file: The document of the scene.
        out: The output folder.
        force: If true, files in ``out`` are overwritten even if they were not written by a demo.

    Raises:
        OutputError: If ``out`` contains files that were not written by a demo and ``force`` is not set.
    """
    if not force:
        ensure_folder_replaceable(out, REPORT)
    try:
        need_extra("expert", "its inverse kinematics")
    except MissingExtraError as error:
        return ArmDemo("", False, 0.0, str(error))
    _mark(out)
    scene = lower_file(scene_file, Cache.default())
    done = ArmDemo("", False, 0.0, "no object in the scene is small enough for the arm to grasp and place")
    for idea in islice(_ideas(scene), ATTEMPTS):
        done = _try(idea, scene, scene_file, out)
        if done.success:
            break
    return done


def _mark(out: Path) -> None:
    """Mark the demo's folder as a project so that its documents can refer to each other.

    Nothing is done if the folder is already inside a project.
    """
    if find_project(out) is not None:
        return
    marker = markers(Project(out.parent))
    if not marker:
        raise OutputError(
            f"{out.parent} also contains other files; use a separate folder for the demo, such as -o {out.parent}/demo"
        )
    for file, text in marker.items():
        write_atomically(file, text.encode())


def _ideas(scene: Scene) -> Iterator[_Idea]:
    """Yield possible tasks in order of preference.

    Containers are preferred over flat supports, and small objects over large ones.
    """
    fingers = jaws(lower_robot("arm", RobotSpec(model=ARM), Path()))
    assert fingers is not None
    state, judge = SceneState.initial(scene), Judge(scene)
    free = [item for item in scene.objects if not item.fixed]
    carriers = {relation.args[1] for relation in scene.relations if len(relation.args) == 2}
    size = {item.name: float(np.ptp(world_bounds(item, item.X_WO), axis=0).max()) for item in free}
    things = [item for item in sorted(free, key=lambda item: size[item.name]) if item.name not in carriers]

    @cache
    def is_graspable(name: str) -> bool:
        item = scene.object(name)
        return bool(grasps(solid(item, state), center_of_mass(item, state.poses[name]), fingers, down()))

    for inside, thing, target in product((True, False), things, free):
        idea = _Idea(thing.name, target.name, inside)
        fits = target.name != thing.name and (inside or size[target.name] > size[thing.name])
        if fits and is_graspable(thing.name) and _can_hold(judge, idea, state):
            for base, yaw in islice(_bases(scene, thing, target), 1):
                yield replace(idea, base=base, yaw=yaw)


def _can_hold(judge: Judge, idea: _Idea, state: SceneState) -> bool:
    """Return True if there is a placement of the object for which the goal would hold."""
    found = places(judge.scene, state, idea.thing, idea.target, idea.inside)
    states = [replace(state, poses={**state.poses, idea.thing: place.X_WO}) for place in found]
    try:
        return bool(states) and bool(judge.batch(idea.goal, StateBatch.of(judge.scene, states))[0].any())
    except PredicateError:  # raised for objects without a cavity
        return False


def _bases(scene: Scene, thing: SceneObject, target: SceneObject) -> Iterator[tuple[Array, float]]:
    """Yield base poses from which the arm can reach both objects, starting with the best one.

    Each pose consists of a position [m] and a heading [rad].
    """
    ends = [np.mean(world_bounds(item, item.X_WO), axis=0) for item in (thing, target)]
    middle = (ends[0] + ends[1]) / 2
    tables = [world_bounds(item, item.X_WO) for item in scene.objects if item.fixed]
    obstacles = [world_bounds(item, item.X_WO) for item in scene.objects if not item.fixed]
    ground = min(float(low[2]) for low, _ in obstacles)
    seen_from = scene.cameras[0].X_WC.p - middle if scene.cameras else np.array([-1.0, 0.0, 0.0])
    arm = find_robot(ARM)
    assert arm is not None
    found: list[tuple[bool, Array, float]] = []
    for side, near in product(SIDES, NEAR):
        angle = math.atan2(seen_from[1], seen_from[0]) + math.radians(side)
        base = np.array([middle[0] + near * math.cos(angle), middle[1] + near * math.sin(angle), ground])
        away = [float(np.linalg.norm(end[:2] - base[:2])) for end in ends]
        blocked = any(np.linalg.norm(np.maximum(_outside(base, box), 0.0)) < APART for box in obstacles)
        if min(away) >= NEAREST and max(away) <= arm.reach - MARGIN and not blocked:
            stands = any(_outside(base, box).max() <= -EDGE for box in tables)
            found.append((stands, base, angle + math.pi))
    for _, base, yaw in sorted(found, key=lambda each: not each[0]):
        yield base, math.remainder(yaw, 2 * math.pi)


def _outside(point: Array, box: tuple[Array, Array]) -> Array:
    """Return the distance of a point from a box along x and y [m], as an array of shape (2,).

    A value is negative if the point is within the extent of the box along that axis.
    """
    return np.asarray(np.maximum(box[0] - point, point - box[1])[:2])


def _try(idea: _Idea, scene: Scene, scene_file: Path, out: Path) -> ArmDemo:
    """Write the task for an idea, have the expert perform it, and render the result."""
    documents = {SCENE: _scene_text(idea, scene, scene_file, out), TASK: _task_text(idea)}
    with staged(out) as folder:
        write_files(folder, {name: text.encode() for name, text in documents.items()})
        task = load_task(folder / TASK, Cache.default())
        start = RolloutStart(0, 0, MappingProxyType({}), SceneState.initial(task.scene))
        expert = ExpertPolicy(task)
        with open_world(task.scene, "mujoco") as world:
            one = rollout(task, start, expert, world)
            strip = _strip(task, start, one, world)
        reason = "" if one.success else "; ".join(dict.fromkeys([*expert.log, one.reason]))
        seconds = round(one.steps / task.control_hz, 1)
        done = ArmDemo(idea.instruction, one.success, seconds, reason, out / TASK, out / STRIP)
        written = {name: text.encode() for name, text in documents.items()} | {STRIP: png_bytes(strip)}
        hashes = {name: hashlib.sha256(data).hexdigest() for name, data in written.items()}
        report = json.dumps(done.to_json() | {"files": hashes}, indent=1, ensure_ascii=False) + "\n"
        write_files(folder, written | {REPORT: report.encode()})
    return done


def _scene_text(idea: _Idea, scene: Scene, scene_file: Path, out: Path) -> str:
    """Return the text of a scene that adds an arm, and a camera that views the arm, to the captured scene."""
    toward = np.array([math.cos(idea.yaw), math.sin(idea.yaw), 0.0])
    aside = np.array([-toward[1], toward[0], 0.0])
    # View the arm from the front and slightly from the side, at a distance [m] that shows its targets too.
    eye = idea.base + 1.6 * toward + 0.8 * aside + np.array([0.0, 0.0, 0.8])
    look = idea.base + 0.27 * toward + np.array([0.0, 0.0, 0.3])
    base = Path(os.path.relpath(scene_file.resolve(), out.resolve())).as_posix()
    return (
        f"# {scene.name}, with an arm beside it\nsimfoundry: scene/1\nname: {scene.name}_arm\nextends: {base}\n"
        "viewpoint: arm\n\nrobots:\n"
        f"  arm: {{model: {ARM}, pose: {{xyz: {_numbers(idea.base)}, yaw_deg: {math.degrees(idea.yaw):.1f}}}}}\n\n"
        f"cameras:\n  {CAMERA}:\n    size: [640, 480]\n    fx: 680\n    fy: 680\n"
        f"    pose: {{xyz: {_numbers(eye)}, look_at: {_numbers(look)}}}\n"
    )


def _task_text(idea: _Idea) -> str:
    return (
        f"simfoundry: task/1\nname: {idea.thing}_{'in' if idea.inside else 'on'}_{idea.target}\nscene: {SCENE}\n"
        f"instruction: {idea.instruction}\n\ngoal:\n  all:\n    - {idea.goal}\n    - Released({idea.thing})\n\n"
        f"subtasks:\n  pick_up_{idea.thing}: {{goal: Grasped({idea.thing})}}\n"
    )


def _numbers(values: Array) -> str:
    return f"[{', '.join(f'{float(v):.4g}' for v in values)}]"


def _strip(task: Task, start: RolloutStart, one: Rollout, world: World) -> Image:
    """Replay a rollout and return an image strip.

    The strip shows labeled images at equal time intervals, side by side.
    """
    shown = {round(step) for step in np.linspace(0, one.steps, PICTURES)[1:]}
    world.reset(start.state)
    panels = [("0.0 s", _picture(world))]
    execution = Execution(world, task.robots, ActionSpace.JOINT_POSITION, task.control_hz)
    steps = (step for action in one.actions for step in execution.act(action))
    panels += [(f"{step / task.control_hz:.1f} s", _picture(world)) for step in steps if step in shown]
    return side_by_side(panels)


def _picture(world: World) -> Image:
    """Render an image from the demo's camera.

    Without a GL driver, the scene is ray-cast, and the arm is treated as an ordinary object.
    """
    if choose_engine() is not Engine.RAYCAST:
        return np.asarray(world.render(CAMERA, *SIZE))
    scene, state = world.scene, world.state()
    objects = (*scene.objects, *(_robot_object(robot, state) for robot in scene.robots))
    poses = {item.name: state.poses.get(item.name, item.X_WO) for item in objects}
    joints = {f"{item.name}.{j.name}": j.position for item in objects for j in item.joints if j.has_axis}
    whole = SceneState.of(poses, joints | dict(state.joints), state.motions)
    return raycast(replace(scene, objects=objects, robots=(), mounted=()), camera_of(world, CAMERA, *SIZE), whole).color


def _robot_object(robot: Robot, state: SceneState) -> SceneObject:
    """Convert a robot to an object whose joint positions are those in the state."""
    native = mujoco_model(robot)
    assert native is not None
    item = as_object(robot, read_robot(robot, native, f"{robot.name}.")).item
    now = state.robots.get(robot.name, {})
    return replace(item, joints=tuple(replace(j, position=now.get(j.name, j.position)) for j in item.joints))
