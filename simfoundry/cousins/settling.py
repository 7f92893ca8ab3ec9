"""A layout at rest: physics until nothing moves, and what moved how far on the way."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from simfoundry.evaluate.place import rounded
from simfoundry.geometry.frames import Pose
from simfoundry.scene.state import SceneState
from simfoundry.worlds.footing import is_ball
from simfoundry.worlds.mujoco_world import MujocoWorld
from simfoundry.worlds.rest import is_confined, is_still

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

CALM_S = 2.0
"""Where then only balls roll on, their motion is taken out [s]: what is left of the time shows whether a hollow holds
them."""


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
    calmed: SceneState | None = None
    while elapsed < MOST_S:
        world.step(round(STEP_S / world.timestep))
        elapsed += STEP_S
        now = world.state()
        restless = tuple(
            o.name
            for o in items
            if not is_still(o, last.poses[o.name], now.poses[o.name], STILL_M, math.radians(STILL_DEG))
        )
        last = now
        if restless and elapsed == CALM_S and all(is_ball(world.scene.object(name)) for name in restless):
            world.halt()  # what then stays where it is lies in a hollow
            calmed = now
        if _asleep(world) or (elapsed >= LEAST_S and not restless):
            restless = ()
            break
        if world.trouble():
            restless = restless or tuple(o.name for o in items)
            break
    if calmed is not None:
        restless = tuple(n for n in restless if not is_confined(world.scene.object(n), calmed.poses[n], now.poses[n]))
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


def tilt_deg(before: Pose, after: Pose) -> float:
    """How far the axis that pointed up has turned from the vertical [deg]."""
    up = before.rotation[2]
    return math.degrees(math.acos(float(np.clip((after.rotation @ up)[2], -1.0, 1.0))))
