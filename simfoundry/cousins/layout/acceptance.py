"""Accept or reject layouts: settle them, then check relations, visibility and reachability."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from simfoundry.cousins.layout.propose import Layout
from simfoundry.cousins.layout.twin import ELSEWHERE, Twin
from simfoundry.cousins.layout.views import SEEN, best_view
from simfoundry.cousins.recipe.candidate import Reason
from simfoundry.evaluate.resets.placement import rounded
from simfoundry.geometry.frames import Pose
from simfoundry.predicates import StateBatch
from simfoundry.scene.state import SceneState
from simfoundry.spec.models.predicate import Call, parse_call
from simfoundry.worlds.mujoco_world import MujocoWorld
from simfoundry.worlds.rest import is_ball, is_confined, run_to_rest, tilt_deg

if TYPE_CHECKING:
    from simfoundry.robots.reach import Reached

# Maximum penetration depth at rest [m].
PENETRATION = 0.001

# Maximum displacement [m] and tilt [deg] during settling, except for objects dropped onto or into the anchor.
DRIFT, TILT_DEG = 0.01, 5.0


@dataclass(frozen=True, eq=False)
class Examined:
    """The result of examining a layout.

    Attributes:
        reasons: Reasons for rejection. There are none if the layout was accepted.
        state: Settled state of all objects, or their initial state if an object is too far away for all arms.
        unchecked: Checks that could not be performed.
    """

    reasons: tuple[Reason, ...]
    state: SceneState
    unchecked: tuple[str, ...]

    @property
    def accepted(self) -> bool:
        """True if the layout was accepted."""
        return not self.reasons


def examine(twin: Twin, layout: Layout) -> Examined:
    """Settle a layout and check it. If a cheap check fails, the more expensive checks are skipped."""
    absent, start = twin.absent - set(layout.poses), twin.posed(layout.poses)
    if too_far := tuple(_too_far(twin, layout, start)):
        return Examined(too_far, start, ())
    settled = settle_layout(twin.world, start, absent)
    reasons = list(_at_rest(layout, settled))
    unchecked: list[str] = []
    if not reasons:
        reasons += _as_asked(twin, layout, settled.state)
        reasons += _seen(twin, layout, settled.state, unchecked)
    if not reasons:
        reasons += _reached(twin, settled.state, unchecked)
    return Examined(tuple(reasons), settled.state, tuple(dict.fromkeys(unchecked)))


def _at_rest(layout: Layout, settled: SettledLayout) -> Iterator[Reason]:
    for name in settled.restless:
        yield Reason("restless", f"`{name}` does not come to rest within {MOST_S:g} s")
    if settled.deepest > PENETRATION:
        a, b = settled.between
        text = f"`{a}` and `{b}` overlap by {1000 * settled.deepest:.1f} mm at rest"
        yield Reason("penetrates", text, {"depth_m": settled.deepest})
    for name, far in settled.moved.items():
        if name not in layout.dropped and far > DRIFT:
            yield Reason("moved", f"`{name}` moves {100 * far:.1f} cm as it settles", {"moved_m": far})
    for name, tilt in settled.tilted.items():
        if name not in layout.dropped and tilt > TILT_DEG:
            yield Reason("tilted", f"`{name}` tilts by {tilt:.1f} deg as it settles", {"tilted_deg": tilt})


def _as_asked(twin: Twin, layout: Layout, state: SceneState) -> Iterator[Reason]:
    """Yield a reason for each required relation that does not hold, and one more if the goal is already true."""
    required = (
        ("not_as_asked", "does not hold at rest", layout.asked),
        ("relation_lost", "no longer holds", kept_relations(twin, layout.poses)),
    )
    conditions: dict[str, Any] = {code: {"all": texts} for code, _, texts in required if texts}
    if twin.goal is not None:
        conditions["goal_true"] = twin.goal
    holds = twin.judge.holds(conditions, StateBatch.of(twin.scene, [state]))
    for code, says, texts in required:
        if texts and not holds[code][0]:  # usually, all conditions are true
            for text, verdict in ((text, twin.judge(text, state)) for text in texts):
                if not verdict.value:
                    yield Reason(code, f"{text} {says}: {verdict.why}", {"margin": verdict.margin})
    if twin.goal is not None and holds["goal_true"][0]:
        goal = twin.judge(twin.goal, state)
        yield Reason("goal_true", f"the goal is already true: {goal.why}", {"margin": goal.margin})


def kept_relations(twin: Twin, moved: Iterable[str]) -> tuple[str, ...]:
    """Return the relations of the twin that must still hold after the ``moved`` objects have been moved.

    These are all relations that do not involve a moved object, relations between a rider and its support, and relations
    that concern only the joints or the orientation of a single object.
    """
    gone = set(moved)

    def is_kept(call: Call) -> bool:
        names = [a.partition(".")[0] for a in call.args]
        rides = len(names) == 2 and set(names) <= gone and names[0] in twin.riders(names[1])
        return rides or not gone & set(names) or call.predicate in ("Open", "Closed", "Upright")

    return tuple(text for text in twin.relations if is_kept(parse_call(text)))


def _seen(twin: Twin, layout: Layout, state: SceneState, unchecked: list[str]) -> Iterator[Reason]:
    """Yield a reason for each task object that no camera sees well enough.

    If there is no task, the moved objects other than distractors are checked.
    """
    cameras = twin.scene.cameras
    if not cameras:
        unchecked.append("view: the scene has no static camera")
        return
    surfaces = twin.surfaces(state, twin.absent - set(layout.poses))
    for name in twin.task_objects or tuple(n for n in layout.poses if n not in twin.absent):
        least = min(SEEN, twin.shares_seen.get(name, SEEN))
        camera, share = best_view(cameras, name, surfaces, least)
        if share < least:
            text = f"only {share:.0%} of `{name}` is visible from the best camera, `{camera}`; {least:.0%} is required"
            yield Reason("out_of_view", text, {"share": share})


def _reached(twin: Twin, state: SceneState, unchecked: list[str]) -> Iterator[Reason]:
    """Yield a reason for each task object that no arm can reach, according to inverse kinematics."""
    if twin.robots.reach.missing:
        unchecked.append(f"reach: {twin.robots.reach.missing}")
        return
    if twin.goal is None:
        unchecked.append("reach: no task specifies which objects must be reached")
        return
    for name in _grasped(twin):
        result = twin.robots.reach(*twin.box(name, state.poses[name]))
        if not result.reached:
            yield _out_of_reach(name, result)


def _too_far(twin: Twin, layout: Layout, state: SceneState) -> Iterator[Reason]:
    """Yield a reason for each task object that is too far away for every arm.

    The distance that the object may move while it settles is taken into account.
    """
    for name in _grasped(twin) if twin.goal is not None else ():
        box = twin.box(name, state.poses[name])
        slack = DRIFT + math.sin(math.radians(TILT_DEG)) * float(np.linalg.norm(box[1] - box[0]))
        if name not in layout.dropped and twin.robots.reach.is_too_short(*box, slack):
            yield _out_of_reach(name, twin.robots.reach.nearest(*box))


def _grasped(twin: Twin) -> tuple[str, ...]:
    return tuple(name for name in twin.task_objects if not twin.scene.object(name).fixed)


def _out_of_reach(name: str, result: Reached) -> Reason:
    where = f"it is {result.away:.2f} m from the base of `{result.robot}`"
    return Reason("out_of_reach", f"no arm can reach `{name}` from above: {where}", {"away_m": result.away})


# Minimum settling time, interval between rest checks, and maximum settling time [s]. Settling ends before the minimum
# time only if the engine has put all bodies to sleep, so that nothing can move again.
LEAST_S, STEP_S, MOST_S = 1.0, 0.125, 4.0

# Sleep threshold [m/s]. MuJoCo puts a body to sleep after ten steps below this speed. Otherwise, bodies would creep by
# hundredths of a millimeter.
SLEEP = 5e-4

# Time [s] after which velocities are set to zero if only balls are still moving, so that balls stay in a hollow.
CALM_S = 2.0


@dataclass(frozen=True, eq=False)
class SettledLayout:
    """The result of settling a layout.

    Attributes:
        state: Final state, rounded to the precision of documents.
        moved: Displacement of each free object [m].
        tilted: Tilt of each free object [deg]. The tilt of a ball is 0.
        restless: Names of the objects that did not come to rest.
        deepest: Largest final penetration depth [m].
        between: Names of the two objects with the largest penetration.
    """

    state: SceneState
    moved: dict[str, float]
    tilted: dict[str, float]
    restless: tuple[str, ...]
    deepest: float
    between: tuple[str, str]


def settle_layout(world: MujocoWorld, state: SceneState, absent: Iterable[str] = ()) -> SettledLayout:
    """Simulate a state until all objects are at rest or the settling time runs out.

    Objects in ``absent`` are ignored. They are moved far away from the scene and from each other.
    """
    gone = set(absent)
    items = [o for o in world.scene.objects if not o.fixed and o.name not in gone]
    away = {o.name: Pose.of((ELSEWHERE * (k + 1), 0.0, 0.0)) for k, o in enumerate(world.scene.objects)}
    _let_sleep(world)
    world.reset(_with_poses(state, {n: away[n] for n in gone}) if gone else state)
    calmed: SceneState | None = None

    def watch(elapsed: float, moving: set[str]) -> bool:
        nonlocal calmed
        if moving and elapsed == CALM_S and all(is_ball(world.scene.object(name)) for name in moving):
            world.halt()
            calmed = world.state()
        return _is_asleep(world) or bool(world.trouble())

    moving = run_to_rest(world, STEP_S, LEAST_S, MOST_S, lambda _: gone, watch)
    now = world.state()
    if _is_asleep(world):
        moving = set()
    elif world.trouble():
        moving = moving or {o.name for o in items}
    elif calmed is not None:
        moving = {n for n in moving if not is_confined(world.scene.object(n), calmed.poses[n], now.poses[n])}
    deepest, between = 0.0, ("", "")
    for contact in world.contacts():
        if contact.depth > deepest and not gone & {contact.a, contact.b}:
            deepest, between = contact.depth, (contact.a, contact.b)
    end = rounded(now)
    if gone:
        end = _with_poses(end, {n: state.poses[n] for n in gone})
    moved = {o.name: float(np.linalg.norm(end.poses[o.name].p - state.poses[o.name].p)) for o in items}
    tilted = {o.name: 0.0 if is_ball(o) else tilt_deg(state.poses[o.name], end.poses[o.name]) for o in items}
    return SettledLayout(end, moved, tilted, tuple(o.name for o in items if o.name in moving), deepest, between)


def _with_poses(state: SceneState, poses: dict[str, Pose]) -> SceneState:
    return SceneState.of({**state.poses, **poses}, state.joints, state.motions)


def _let_sleep(world: MujocoWorld) -> None:
    """Let MuJoCo skip the simulation of bodies at rest until something touches them.

    Sleeping requires MuJoCo 3.4. Older versions simulate all bodies.
    """
    import mujoco

    sleep = getattr(mujoco.mjtEnableBit, "mjENBL_SLEEP", None)
    if sleep is not None:
        world.model.opt.enableflags |= int(sleep)
        world.model.opt.sleep_tolerance = SLEEP


def _is_asleep(world: MujocoWorld) -> bool:
    """Return True if all movable bodies are asleep."""
    return int(getattr(world.data, "ntree_awake", 1)) == 0
