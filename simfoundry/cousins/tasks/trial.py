"""Trials: move an object or a joint, simulate until everything is at rest, and test the requested predicates."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from simfoundry.cousins.layout.acceptance import settle_layout
from simfoundry.cousins.layout.supports import Outline, Support
from simfoundry.cousins.layout.twin import bare
from simfoundry.cousins.tasks.context import TaskContext
from simfoundry.geometry.frames import Array, Pose, rpy_from_quat
from simfoundry.scene.carriers import PlaceError
from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.model import Joint
from simfoundry.scene.place import CLEARANCE, overlap, solve
from simfoundry.scene.state import SceneState, object_at
from simfoundry.spec.models.scene import Place
from simfoundry.worlds import open_world

# Maximum penetration at rest [m]; objects wedged between the walls of another object exceed it.
OVERLAP = 0.002

# Maximum displacement [m] of all other objects while an object comes to rest.
DISTURBED = 0.02


# Duration of the simulations in other engines [s] that test whether a state lasts.
LASTS = 2.0

# Offset [m] that is added to each placement, because hands are inexact. For example, it prevents balls from being
# balanced on each other.
ASTRAY = (0.0023, 0.0017)


class Rest(NamedTuple):
    """A state at rest.

    ``why`` explains why the state is unacceptable. It is empty if the state is acceptable.
    """

    state: SceneState
    why: str = ""


def dropped(
    setting: TaskContext, name: str, target: str, inside: bool, xy: tuple[float, float], q: Array, state: SceneState
) -> Pose:
    """Return the pose in which an object that is lowered from above first touches its target.

    Args:
        setting: Context of the task.
        name: Name of the object.
        target: Object or part on or in which the object is placed.
        inside: True to place it inside the target.
        xy: Position of the object's center [m].
        q: Orientation of the object (wxyz).
        state: State of the scene.

    Raises:
        PlaceError: If the object misses the target or does not fit.
    """
    twin = setting.twin
    shape = twin.shape(name, Pose.of(q=q))
    middle = [sum(shape.extent(axis)) / 2 for axis in np.eye(3)[:2]]
    roll, pitch, yaw = np.degrees(rpy_from_quat(q)).tolist()
    on, within = (None, target) if inside and "." in target else (target, None)
    at = (xy[0] - middle[0] + ASTRAY[0], xy[1] - middle[1] + ASTRAY[1])
    place = Place(on=on, inside=within, xy=at, rpy_deg=(roll, pitch, yaw))
    owner = target.partition(".")[0]
    found = solve(twin[name].item, place, {owner: object_at(twin.scene.object(owner), state)}, twin.scene.viewer)
    return Pose.of(found.p, q)


def standing(setting: TaskContext, name: str, level: Support, xy: tuple[float, float], q: Array) -> Pose:
    """Return the pose in which an object stands on a level surface of another object.

    Args:
        setting: Context of the task.
        name: Name of the object.
        level: The level surface.
        xy: Position of the object's center [m].
        q: Orientation of the object (wxyz).

    Raises:
        PlaceError: If the object would overhang the surface or collide with the surface's owner.
    """
    twin = setting.twin
    turned = twin.shape(name, Pose.of(q=q))
    outline = Outline.of(turned)
    middle = complex(*xy)
    if not level.holds(np.array([xy]), np.array([1.0 + 0.0j]), outline.spread)[0]:
        raise PlaceError(f"`{name}` would overhang the level of `{level.name}` at {level.height:.3f} m")
    at = middle - outline.middle
    X_WO = Pose.of((at.real, at.imag, level.height - outline.low + CLEARANCE), q)
    if overlap(turned.moved(X_WO.p), twin.shape(level.name, twin.state.poses[level.name])):
        raise PlaceError(f"`{name}` does not fit on the level of `{level.name}` at {level.height:.3f} m")
    return X_WO


def put(setting: TaskContext, name: str, X_WO: Pose, state: SceneState) -> SceneState:
    """Return a state in which an object and its riders have been moved."""
    moved = X_WO @ state.poses[name].inverse()
    along = {n: moved @ state.poses[n] for n in setting.twin.riders(name)}
    return SceneState.of({**state.poses, **along, name: X_WO}, state.joints, state.motions)


def turned(
    setting: TaskContext, owner: str, joint: Joint, to: float, held: dict[str, str], state: SceneState
) -> SceneState:
    """Return a state in which a joint has been moved, along with the objects that its links support.

    Args:
        setting: Context of the task.
        owner: Name of the object that the joint belongs to.
        joint: The joint.
        to: New joint position [rad or m].
        held: Link that supports each placed object, as ``owner.link``, keyed by object name.
        state: Original state.
    """
    item = setting.twin.scene.object(owner)
    joints = {**state.joints, f"{owner}.{joint.name}": to}
    after = SceneState.of(state.poses, joints, state.motions)
    before, now = (link_poses(item, s.of_object(item)) for s in (state, after))
    poses = dict(state.poses)
    for name, link in held.items():
        if link.partition(".")[0] == owner:
            part = link.partition(".")[2] or item.root.name
            X_WO = state.poses[owner]
            poses[name] = X_WO @ now[part] @ before[part].inverse() @ X_WO.inverse() @ poses[name]
    return SceneState.of(poses, joints, state.motions)


def rest(setting: TaskContext, state: SceneState, moving: set[str]) -> Rest:
    """Simulate until everything is at rest. Only the objects in ``moving`` may move as they settle."""
    settled = settle_layout(setting.twin.world, state, setting.twin.absent)
    if settled.restless:
        return Rest(settled.state, f"`{settled.restless[0]}` does not come to rest")
    if settled.deepest > OVERLAP:
        a, b = settled.between
        return Rest(settled.state, f"`{a}` and `{b}` overlap by {1000 * settled.deepest:.1f} mm")
    for name, far in settled.moved.items():
        if name not in moving and far > DISTURBED:
            return Rest(settled.state, f"`{name}` is pushed away by {100 * far:.1f} cm")
    return Rest(settled.state)


def lost(setting: TaskContext, condition: Any, state: SceneState) -> str:
    """Explain why a condition that holds in MuJoCo does not last in another engine.

    The result is an empty string if the condition lasts. Each test uses a new world because PyBullet keeps contacts
    across a reset, so earlier trials could affect the result.

    Raises:
        MissingEngineError: If an engine is not installed.
    """
    for engine in (name for name in setting.engines if name != "mujoco"):
        with open_world(bare(setting.twin.scene), engine) as world:
            world.reset(state)
            world.step(round(LASTS / world.timestep))
            verdict = setting.twin.judge(condition, world.state())
        if not verdict.value:
            return f"after {LASTS:g} s in {engine}, {verdict.why}"
    return ""


def open_end(setting: TaskContext, owner: str, joint: Joint, wanted: str) -> float | None:
    """Return the limit at which a joint is ``Open`` or ``Closed`` [rad or m].

    The result is None if there is no such limit. ``wanted`` is ``Open`` or ``Closed``, and ``owner`` is the name of the
    object that the joint belongs to.
    """
    twin = setting.twin
    for end in sorted(joint.limits or (), key=abs, reverse=wanted == "Open"):
        state = turned(setting, owner, joint, end, {}, twin.state)
        if twin.judge(f"{wanted}({owner}.{joint.name})", state).value:
            return float(end)
    return None
