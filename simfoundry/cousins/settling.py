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

LEAST_S, STEP_S, MOST_S = 1.0, 0.25, 4.0
"""Physics runs at least so long [s], then on in steps of so much until nothing moved over one, and at most so long."""

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
    world.reset(state)
    world.step(round((LEAST_S - STEP_S) / world.timestep))
    elapsed, last = LEAST_S - STEP_S, world.state()
    while True:
        world.step(round(STEP_S / world.timestep))
        elapsed += STEP_S
        now = world.state()
        restless = tuple(o.name for o in items if not _stayed(last.poses[o.name], now.poses[o.name], is_ball(o)))
        if not restless or elapsed >= MOST_S or world.trouble():
            break
        last = now
    deepest, between = 0.0, ("", "")
    for contact in world.contacts():
        if contact.depth > deepest and not gone & {contact.a, contact.b}:
            deepest, between = contact.depth, (contact.a, contact.b)
    end = rounded(now)
    moved = {o.name: float(np.linalg.norm(end.poses[o.name].p - state.poses[o.name].p)) for o in items}
    tilted = {o.name: 0.0 if is_ball(o) else tilt_deg(state.poses[o.name], end.poses[o.name]) for o in items}
    return Settled(end, moved, tilted, restless, deepest, between, elapsed)


def _let_sleep(world: MujocoWorld) -> None:
    """What is at rest costs nothing: MuJoCo wakes it when something comes near. Versions before 3.4 cannot."""
    import mujoco

    sleep = getattr(mujoco.mjtEnableBit, "mjENBL_SLEEP", None)
    if sleep is not None:
        world.model.opt.enableflags |= int(sleep)


def _stayed(before: Pose, after: Pose, ball: bool) -> bool:
    still = float(np.linalg.norm(after.p - before.p)) <= STILL_M
    return still and (ball or math.degrees(before.angle_to(after)) <= STILL_DEG)


def tilt_deg(before: Pose, after: Pose) -> float:
    """How far the axis that pointed up has turned from the vertical [deg]."""
    up = before.rotation[2]
    return math.degrees(math.acos(float(np.clip((after.rotation @ up)[2], -1.0, 1.0))))
