"""A layout at rest: physics until nothing moves, and what moved how far on the way."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from simfoundry.evaluate.place import rounded
from simfoundry.scene.frames import Pose
from simfoundry.scene.state import SceneState
from simfoundry.worlds.footing import is_ball
from simfoundry.worlds.mujoco_world import MujocoWorld

LEAST_S, STEP_S, MOST_S = 1.0, 0.125, 4.0
"""Physics runs at least so long [s], then on in steps of so much until nothing moved over one, and at most so long.

It may end earlier only where the engine has put all things to sleep: nothing would ever move again.
"""

ELSEWHERE = 100.0
"""How far away [m] what is absent falls, where nothing meets it."""

SLEEP = 5e-4
"""The engine puts to sleep what moves slower than this [m/s] for ten steps; awake, it creeps hundredths of a mm."""

STILL_M, STILL_DEG = 1e-4, 0.1
"""What moves or turns no farther in a step is at rest. A ball may turn."""


@dataclass(frozen=True, eq=False)
class Settled:
    """The ``state`` at rest, rounded; how far each free object got, in ``moved`` [m] and ``tilted`` [deg].

    ``restless`` never came to rest; ``deepest`` [m] is the worst overlap at the end, between the two named;
    ``seconds`` of physics were needed.
    """

    state: SceneState
    moved: dict[str, float]
    tilted: dict[str, float]
    restless: tuple[str, ...]
    deepest: float
    between: tuple[str, str]
    seconds: float


def settle_layout(world: MujocoWorld, state: SceneState, absent: Iterable[str] = ()) -> Settled:
    """Let a state come to rest. The world's model is reused as it is; what is ``absent`` is not looked at."""
    gone = set(absent)
    items = [o for o in world.scene.objects if not o.fixed and o.name not in gone]
    _let_sleep(world)
    world.reset(_without(world, state, gone))
    elapsed, last, restless = 0.0, state, tuple[str, ...]()
    while elapsed < MOST_S:
        world.step(round(STEP_S / world.timestep))
        elapsed += STEP_S
        now = world.state()
        restless = tuple(o.name for o in items if not _stayed(last.poses[o.name], now.poses[o.name], is_ball(o)))
        last = now
        if _asleep(world) or (elapsed >= LEAST_S and not restless):
            restless = ()
            break
        if world.trouble():
            restless = restless or tuple(o.name for o in items)
            break
    deepest, between = 0.0, ("", "")
    for contact in world.contacts():
        if contact.depth > deepest and not gone & {contact.a, contact.b}:
            deepest, between = contact.depth, (contact.a, contact.b)
    end = rounded(now)
    if gone:
        end = SceneState.of({**end.poses, **{n: state.poses[n] for n in gone}}, end.joints, end.motions)
    moved = {o.name: float(np.linalg.norm(end.poses[o.name].p - state.poses[o.name].p)) for o in items}
    tilted = {o.name: 0.0 if is_ball(o) else tilt_deg(state.poses[o.name], end.poses[o.name]) for o in items}
    return Settled(end, moved, tilted, restless, deepest, between, elapsed)


def _without(world: MujocoWorld, state: SceneState, absent: set[str]) -> SceneState:
    """The state with what is absent far away from all else and from each other."""
    if not absent:
        return state
    away = {o.name: Pose.of((ELSEWHERE * (k + 1), 0.0, 0.0)) for k, o in enumerate(world.scene.objects)}
    return SceneState.of({**state.poses, **{n: away[n] for n in absent}}, state.joints, state.motions)


def _let_sleep(world: MujocoWorld) -> None:
    """What is at rest costs nothing: MuJoCo wakes it when something comes near. Versions before 3.4 cannot."""
    import mujoco

    sleep = getattr(mujoco.mjtEnableBit, "mjENBL_SLEEP", None)
    if sleep is not None:
        world.model.opt.enableflags |= int(sleep)
        world.model.opt.sleep_tolerance = SLEEP


def _asleep(world: MujocoWorld) -> bool:
    """Whether nothing is left that could move by itself."""
    return int(getattr(world.data, "ntree_awake", 1)) == 0


def _stayed(before: Pose, after: Pose, ball: bool) -> bool:
    still = float(np.linalg.norm(after.p - before.p)) <= STILL_M
    return still and (ball or math.degrees(before.angle_to(after)) <= STILL_DEG)


def tilt_deg(before: Pose, after: Pose) -> float:
    """How far the axis that pointed up has turned from the vertical [deg]."""
    up = before.rotation[2]
    return math.degrees(math.acos(float(np.clip((after.rotation @ up)[2], -1.0, 1.0))))
