"""Settling, which moves objects from fitted poses, which overlap or float slightly, to poses at rest.

The first phase follows the paper ("Object Depenetration and Physical Stability"): the simulation runs with all
velocities set to zero after each step until the poses are stationary, which separates overlapping objects without
explosions. The second phase runs normal dynamics until everything is at rest, because a body that topples slowly
appears to be still in the first phase.

If the second phase does not end because an object rolls away or falls off an edge, settling is repeated from the same
poses with damped motion, so that an object that is unstable in its fitted pose falls over but stays in place. Finally,
objects that rest on a very small base are nudged, because a simulator can balance a pencil on its tip forever.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import numpy as np

from simfoundry.scene.model import SceneObject
from simfoundry.scene.object_shapes import world_bounds
from simfoundry.scene.state import SceneState
from simfoundry.worlds.base import Contact, World
from simfoundry.worlds.rest import (
    NUDGE_DEG,
    STEEP,
    has_foot,
    is_ball,
    is_confined,
    run_to_rest,
    supporters,
    tilt_deg,
    topples,
)

Progress = Callable[[str, float], None]

# Distance [m] below the lowest point of the initial scene at which an object counts as fallen off.
FALLEN = 0.3


@dataclass(frozen=True)
class SettleOptions:
    """Settings for the end of each phase and for the evaluation of the result.

    The quasi-static phase ends when all objects are at rest over ``window_s`` (see :func:`restless`), and the dynamic
    phase ends when they are at rest over ``rest_s``. Each phase has a maximum duration. If the motion is damped,
    velocities are set to zero every ``damped_s``.
    """

    window_s: float = 0.1
    max_quasi_static_s: float = 6.0
    min_dynamic_s: float = 1.0
    rest_s: float = 0.5
    max_dynamic_s: float = 8.0
    damped_s: float = 0.04
    max_damped_s: float = 6.5
    max_drift_m: float = 0.02
    max_tilt_deg: float = 5.0
    max_penetration_m: float = 0.001


@dataclass(frozen=True)
class ObjectSettle:
    """The effect of settling on one object.

    ``penetration_before`` and ``penetration_after`` are the depths [m] of its deepest contacts, ``drift`` is the
    distance [m] from its fitted pose, ``tilt_deg`` is the change in its up axis, and ``turn_deg`` is its total
    rotation. ``supports`` names the objects that support it; ``support_kept`` is False if an ``OnTop`` relation in the
    scene is no longer true. An object that fell off the scene keeps its fitted pose.
    """

    name: str
    penetration_before: float
    penetration_after: float
    drift: float
    tilt_deg: float
    turn_deg: float
    supports: tuple[str, ...]
    support_kept: bool
    problems: tuple[str, ...]

    @property
    def passed(self) -> bool:
        """True if settling the object caused no problems."""
        return not self.problems


@dataclass(frozen=True, eq=False)
class SettleResult:
    """The poses at rest, the effect on each free object, and the objects that fell off or did not come to rest."""

    state: SceneState
    objects: tuple[ObjectSettle, ...]
    lost: tuple[str, ...]

    @property
    def at_rest(self) -> bool:
        """True if every object came to rest on a support."""
        return not self.lost

    @property
    def passed(self) -> bool:
        """True if every object came to rest without problems."""
        return self.at_rest and all(o.passed for o in self.objects)

    def to_json(self) -> dict[str, Any]:
        """Return the result as plain data for reports."""
        objects = [{**asdict(o), "passed": o.passed} for o in self.objects]
        return {"passed": self.passed, "at_rest": self.at_rest, "objects": objects}


def settle(
    world: World,
    options: SettleOptions | None = None,
    progress: Progress | None = None,
    state: SceneState | None = None,
) -> SettleResult:
    """Settle a scene from ``state``, or from its initial state, and leave the world in the settled state."""
    options = options or SettleOptions()
    world.reset(state)
    before, contacts_before = world.state(), world.contacts()
    run = partial(_run, world, progress)
    run("depenetrate", options.window_s, 0.0, options.max_quasi_static_s, halt_s=0.0)
    opened = world.state()
    dynamics = options.rest_s, options.min_dynamic_s, options.max_dynamic_s
    restless = run("rest", *dynamics)
    if restless or _fallen(world, world.state()):
        world.reset(opened)
        run("calm", options.rest_s, 0.0, options.max_damped_s, halt_s=options.damped_s)
        calmed = world.state()
        restless = run("rest", *dynamics)
        balls = {o.name for o in world.scene.objects if o.name in restless and is_ball(o)}
        now = world.state().poses
        restless -= {n for n in balls if is_confined(world.scene.object(n), calmed.poses[n], now[n])}
    world.halt()
    end, contacts_after = world.state(), world.contacts()
    fallen = _fallen(world, end)
    poses = {n: before.poses[n] if n in fallen else p for n, p in end.poses.items()}
    after = SceneState.of(poses, end.joints, end.motions)
    standing = [o for o in world.scene.objects if not o.fixed and o.name not in fallen | restless]
    shaky = [o for o in standing if not is_ball(o) and not has_foot(o, after.poses[o.name], contacts_after)]
    toppling = {o.name for o in shaky if topples(world, after, o)}
    if fallen or toppling:
        world.reset(after)
    reports = []
    for item in world.scene.objects:
        if not item.fixed:
            problems = _what_happened(item.name, restless, fallen, toppling)
            reports.append(_report(world, item, before, end, contacts_before, contacts_after, options, problems))
    return SettleResult(after, tuple(reports), tuple(sorted(restless | fallen)))


def _run(
    world: World, progress: Progress | None, stage: str, window_s: float, least_s: float, most_s: float,
    halt_s: float | None = None,
) -> set[str]:  # fmt: skip
    """Run a phase and return the objects that did not come to rest, except those that fell off the scene."""

    def report(elapsed: float, _: set[str]) -> None:
        if progress is not None:
            progress(stage, elapsed / most_s)

    return run_to_rest(world, window_s, least_s, most_s, partial(_fallen, world), report, halt_s)


def _fallen(world: World, state: SceneState) -> set[str]:
    """Return the objects that have fallen below the initial scene."""
    scene = world.scene
    floor = min((float(world_bounds(o, o.X_WO)[0][2]) for o in scene.objects), default=0.0) - FALLEN
    return {o.name for o in scene.objects if not o.fixed and state.poses[o.name].p[2] < floor}


def _what_happened(name: str, restless: set[str], fallen: set[str], toppling: set[str]) -> list[str]:
    if name in fallen:
        return ["fell off the scene and keeps its fitted pose"]
    if name in restless:
        return ["did not come to rest"]
    return [f"topples when nudged by {NUDGE_DEG:g} deg"] if name in toppling else []


def _report(
    world: World,
    item: SceneObject,
    before: SceneState,
    after: SceneState,
    contacts_before: list[Contact],
    contacts_after: list[Contact],
    options: SettleOptions,
    problems: list[str],
) -> ObjectSettle:
    """Return the settling result for one object; ``problems`` contains the problems found so far."""
    name = item.name
    start, end = before.poses[name], after.poses[name]
    drift = float(np.linalg.norm(end.p - start.p))
    tilt = tilt_deg(start, end)
    penetration = _deepest(name, contacts_after)
    carried_by = supporters(name, contacts_after)
    wanted = [r.args[1] for r in world.scene.relations if r.predicate == "OnTop" and r.args[0] == name]
    kept = all(w in carried_by for w in wanted)
    if drift > options.max_drift_m:
        problems.append(f"moved {drift * 100:.1f} cm from its pose in the scene")
    if tilt > options.max_tilt_deg and not is_ball(item):
        problems.append(f"tilted {tilt:.0f} deg")
    if penetration > options.max_penetration_m:
        problems.append(f"still penetrates by {penetration * 1000:.1f} mm")
    if not kept:
        problems.append(f"no longer on {', '.join(w for w in wanted if w not in carried_by)}")
    if not supporters(name, contacts_after, STEEP):
        problems.append("is not supported by anything")
    return ObjectSettle(
        name=name,
        penetration_before=_deepest(name, contacts_before),
        penetration_after=penetration,
        drift=drift,
        tilt_deg=tilt,
        turn_deg=math.degrees(start.angle_to(end)),
        supports=carried_by,
        support_kept=kept,
        problems=tuple(problems),
    )


def _deepest(name: str, contacts: list[Contact]) -> float:
    return max((c.depth for c in contacts if name in (c.a, c.b)), default=0.0)
