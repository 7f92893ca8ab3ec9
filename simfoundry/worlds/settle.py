"""Settling of objects, which moves them from fitted poses that overlap or float slightly to poses at rest.

The first phase follows the paper ("Object Depenetration and Physical Stability"): the simulation runs with all
velocities set to zero after each step until the poses are stationary, which separates overlapping objects without
explosions. The second phase runs normal dynamics until everything is at rest, because a body that topples slowly
appears to be still in the first phase.

If the second phase does not end because an object rolls away or falls off an edge, settling is repeated from the same
poses with damped motion, so that an object that is unstable in its fitted pose falls over but stays in place. If
objects are stuck in each other, it ends at once, because they would keep moving. Finally, objects that
rest on a very small base are nudged, because a simulator can balance a pencil on its tip forever.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from simfoundry.scene.model import SceneObject
from simfoundry.scene.object_shapes import world_bounds
from simfoundry.scene.state import SceneState
from simfoundry.worlds import rest
from simfoundry.worlds.base import Contact, World

Progress = Callable[[str, float], None]

# Distance [m] below the lowest point of the initial scene at which an object counts as fallen off.
FALLEN = 0.3

# Depth [m] to which a moving object penetrates another after this time of dynamics [s] if the two are stuck: their
# convex parts interlock, and push each other to and fro. In three piles, the deepest penetrated 28 to 49 mm.
STUCK_M, STUCK_S = 0.01, 3.0


@dataclass(frozen=True)
class SettleOptions:
    """Settings that determine when each phase ends and how the result is evaluated.

    The quasi-static phase ends when all objects are at rest over ``window_s``, and the dynamic phase ends when they are
    at rest over ``rest_s`` (see :func:`~simfoundry.worlds.rest.restless`). Each phase has a maximum duration. If the
    motion is damped, velocities are set to zero every ``damped_s``.
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

    ``penetration_before`` and ``penetration_after`` are the depths [m] of the object's deepest contact before and after
    settling. ``drift`` is the distance [m] from its fitted pose, ``tilt_deg`` is the change in its up axis, and
    ``turn_deg`` is its total rotation. ``supports`` names the objects that support it, and ``support_kept`` is False if
    an ``OnTop`` relation in the scene is no longer true. An object that fell off the scene keeps its fitted pose.
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
    """The result of settling a scene.

    It contains the poses at rest, the effect of settling on each free object, and the objects that fell off the scene
    or kept moving.
    """

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
    is_hopeless: Callable[[], object] = lambda: False,
) -> SettleResult:
    """Settle a scene from ``state``, or from its initial state, and leave the world in the settled state.

    ``is_hopeless`` is called once overlapping objects have been separated as far as possible. If it returns something
    true, settling ends there, and no dynamics are simulated.
    """
    options = options or SettleOptions()
    world.reset(state)
    before = _Snapshot.of(world)
    run = partial(_run, world, progress)
    run("depenetrate", options.window_s, 0.0, options.max_quasi_static_s, halt_s=0.0)
    hopeless = bool(is_hopeless())
    restless = set() if hopeless else _restless(world, run, options)
    world.halt()
    end = _Snapshot.of(world)
    fallen = _fallen(world, end.state)
    poses = {n: before.state.poses[n] if n in fallen else p for n, p in end.state.poses.items()}
    after = SceneState.of(poses, end.state.joints, end.state.motions)
    free = [o for o in world.scene.objects if not o.fixed]
    standing = [o for o in free if o.name not in fallen | restless and not rest.is_ball(o)]
    shaky = [o for o in standing if not hopeless and not rest.has_foot(o, after.poses[o.name], end.contacts)]
    toppling = {o.name for o in shaky if rest.topples(world, after, o)}
    if fallen or toppling:
        world.reset(after)
    causes = dict.fromkeys(toppling, f"topples when nudged by {rest.NUDGE_DEG:g} deg")
    causes |= dict.fromkeys(restless, "did not come to rest")
    causes |= dict.fromkeys(fallen, "fell off the scene and keeps its fitted pose")
    reports = tuple(_report(world, o, before, end, options, causes.get(o.name)) for o in free)
    return SettleResult(after, reports, tuple(sorted(restless | fallen)))


def _restless(world: World, run: Callable[..., set[str]], options: SettleOptions) -> set[str]:
    """Simulate dynamics until all objects are at rest, and return those that do not come to rest."""
    opened = world.state()
    dynamics = options.rest_s, options.min_dynamic_s, options.max_dynamic_s
    restless = run("rest", *dynamics)
    if stuck := _stuck(world, restless):
        return stuck  # what else moves is pushed by these
    if not restless and not _fallen(world, world.state()):
        return restless
    world.reset(opened)
    run("calm", options.rest_s, 0.0, options.max_damped_s, halt_s=options.damped_s)
    calmed = world.state()
    restless = run("rest", *dynamics)
    now = world.state().poses
    return {name for name in restless if not rest.is_confined(world.scene.object(name), calmed.poses[name], now[name])}


class _Snapshot(NamedTuple):
    """The state of a world and its contacts at one point in time."""

    state: SceneState
    contacts: list[Contact]

    @classmethod
    def of(cls, world: World) -> _Snapshot:
        """Return the current snapshot of a world."""
        return cls(world.state(), world.contacts())

    def penetration(self, name: str) -> float:
        """Return the depth [m] of an object's deepest contact."""
        return max((c.depth for c in self.contacts if name in (c.a, c.b)), default=0.0)


def _run(
    world: World, progress: Progress | None, stage: str, window_s: float, least_s: float, most_s: float,
    halt_s: float | None = None,
) -> set[str]:  # fmt: skip
    """Run a phase and return the objects that did not come to rest, except those that fell off the scene."""

    def report(elapsed: float, moving: set[str]) -> bool:
        if progress is not None:
            progress(stage, elapsed / most_s)
        return halt_s is None and elapsed >= STUCK_S and bool(_stuck(world, moving))

    return rest.run_to_rest(world, window_s, least_s, most_s, partial(_fallen, world), report, halt_s)


def _stuck(world: World, moving: Collection[str]) -> set[str]:
    """Return the moving objects that penetrate others so deeply that they will not come to rest."""
    return {name for c in world.contacts() if c.depth > STUCK_M for name in (c.a, c.b) if name in moving}


def _fallen(world: World, state: SceneState) -> set[str]:
    """Return the objects that have fallen below the initial scene."""
    scene = world.scene
    floor = min((float(world_bounds(o, o.X_WO)[0][2]) for o in scene.objects), default=0.0) - FALLEN
    return {o.name for o in scene.objects if not o.fixed and state.poses[o.name].p[2] < floor}


def _report(
    world: World, item: SceneObject, before: _Snapshot, after: _Snapshot, options: SettleOptions, cause: str | None
) -> ObjectSettle:
    """Return the settling result for one object.

    ``cause`` is the reason why the object is not at rest, or None if there is no such reason.
    """
    name = item.name
    start, end = before.state.poses[name], after.state.poses[name]
    drift, tilt = float(np.linalg.norm(end.p - start.p)), rest.tilt_deg(start, end)
    penetration = after.penetration(name)
    supports = rest.supporters(name, after.contacts)
    wanted = [r.args[1] for r in world.scene.relations if r.predicate == "OnTop" and r.args[0] == name]
    lost = [support for support in wanted if support not in supports]
    problems = [cause] if cause else []
    if drift > options.max_drift_m:
        problems.append(f"moved {drift * 100:.1f} cm from its pose in the scene")
    if tilt > options.max_tilt_deg and not rest.is_ball(item):
        problems.append(f"tilted {tilt:.0f} deg")
    if penetration > options.max_penetration_m:
        problems.append(f"still penetrates by {penetration * 1000:.1f} mm")
    if lost:
        problems.append(f"no longer on {', '.join(lost)}")
    if not rest.supporters(name, after.contacts, rest.STEEP):
        problems.append("is not supported by anything")
    turn = math.degrees(start.angle_to(end))
    return ObjectSettle(
        name, before.penetration(name), penetration, drift, tilt, turn, supports, not lost, tuple(problems)
    )
