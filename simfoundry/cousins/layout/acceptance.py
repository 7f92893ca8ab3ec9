"""Accept or reject layouts: settle them, then check their relations, visibility and reachability."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from simfoundry.cousins.layout.propose import Layout
from simfoundry.cousins.layout.twin import ELSEWHERE, Twin
from simfoundry.cousins.layout.views import SEEN, best_view
from simfoundry.cousins.recipe.candidate import Reason
from simfoundry.evaluate.resets.placement import rounded
from simfoundry.geometry.frames import Pose
from simfoundry.predicates import StateBatch, Verdict
from simfoundry.scene.state import SceneState
from simfoundry.spec.models.predicate import Condition, parse_call, parts
from simfoundry.worlds.mujoco_world import MujocoWorld
from simfoundry.worlds.rest import is_ball, is_confined, run_to_rest, tilt_deg

# Maximum penetration depth at rest [m].
PENETRATION = 0.001

# Maximum displacement [m] and tilt [deg] during settling, except for objects dropped onto or into the anchor.
DRIFT, TILT_DEG = 0.01, 5.0


@dataclass(frozen=True, eq=False)
class Examined:
    """The result of examining a layout.

    Attributes:
        accepted: True if the layout was accepted.
        reasons: Reasons for rejection; empty if the layout was accepted.
        poses: Settled poses X_WO of the objects that the layout moved.
        state: Settled state of all objects.
        unchecked: Checks that could not be performed.
    """

    accepted: bool
    reasons: tuple[Reason, ...]
    poses: Mapping[str, Pose]
    state: SceneState
    unchecked: tuple[str, ...]


def examine(twin: Twin, layout: Layout) -> Examined:
    """Settle a layout and check it; the more expensive checks are skipped as soon as a cheaper one fails."""
    absent = twin.absent - set(layout.poses)
    settled = settle_layout(twin.world, twin.posed(layout.poses), absent)
    reasons = list(_at_rest(layout, settled))
    unchecked: list[str] = []
    if not reasons:
        reasons += _as_asked(twin, layout, settled.state)
        reasons += _seen(twin, layout, settled.state, unchecked)
    if not reasons:
        reasons += _reached(twin, settled.state, unchecked)
    poses = MappingProxyType({name: settled.state.poses[name] for name in layout.poses})
    return Examined(not reasons, tuple(reasons), poses, settled.state, tuple(dict.fromkeys(unchecked)))


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
    """Yield a reason for each required relation that does not hold, and a reason if the goal is already true."""
    batch = StateBatch.of(twin.scene, [state])
    for text in _false(twin, layout.asked, batch):
        verdict = twin.judge(text, state)
        if not verdict.value:
            yield Reason("not_as_asked", f"{text} does not hold at rest: {verdict.why}", {"margin": verdict.margin})
    for text in _false(twin, kept_relations(twin, layout.poses), batch):
        verdict = twin.judge(text, state)
        if not verdict.value:
            yield Reason("relation_lost", f"{text} no longer holds: {verdict.why}", {"margin": verdict.margin})
    if twin.goal is not None and (goal := _true(twin, twin.goal, state, batch)) is not None:
        yield Reason("goal_true", f"the goal is already true: {goal.why}", {"margin": goal.margin})


def _false(twin: Twin, conditions: tuple[str, ...], batch: StateBatch) -> tuple[str, ...]:
    """Return all conditions if at least one is false, else an empty tuple, which is the common case."""
    return () if not conditions or twin.judge.batch({"all": conditions}, batch)[0][0] else conditions


def _true(twin: Twin, condition: Condition, state: SceneState, batch: StateBatch) -> Verdict | None:
    """Return the verdict on a condition if it is true, else None; stop at the first part that is false."""
    tag, below = parts(condition)
    for one in below if tag == "all" else (condition,):
        if not twin.judge.batch(one, batch)[0][0]:
            return None
    return twin.judge(condition, state)


def kept_relations(twin: Twin, moved: Iterable[str]) -> tuple[str, ...]:
    """Return the twin's relations that must still hold after the ``moved`` objects are moved.

    These are the relations without moved objects, those between a rider and its support, and those about an object's
    own joints or orientation.
    """
    gone = set(moved)
    found = []
    for text in twin.relations:
        call = parse_call(text)
        names = [a.partition(".")[0] for a in call.args]
        about = gone & set(names)
        rides = len(names) == 2 and set(names) <= gone and names[0] in twin.riders(names[1])
        if not about or rides or call.predicate in ("Open", "Closed", "Upright"):
            found.append(text)
    return tuple(found)


def _seen(twin: Twin, layout: Layout, state: SceneState, unchecked: list[str]) -> Iterator[Reason]:
    """Yield a reason for each task object that no camera sees well enough.

    Without a task, the moved objects other than distractors are checked instead.
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
    """Yield a reason for each task object that no arm can reach, by inverse kinematics."""
    if twin.robots.reach.missing:
        unchecked.append(f"reach: {twin.robots.reach.missing}")
        return
    if twin.goal is None:
        unchecked.append("reach: no task specifies which objects must be reached")
        return
    for name in twin.task_objects:
        if twin.scene.object(name).fixed:
            continue
        result = twin.robots.reach(*twin.box(name, state.poses[name]))
        if not result.reached:
            text = f"no arm can reach `{name}` from above: it is {result.away:.2f} m from the base of "
            text += f"`{result.robot}`"
            yield Reason("out_of_reach", text, {"away_m": result.away})


# Minimum settling time, interval between rest checks, and maximum settling time [s].
#
# Settling ends before the minimum time only if the engine has put all bodies to sleep and nothing can move again.
LEAST_S, STEP_S, MOST_S = 1.0, 0.125, 4.0

# Sleep threshold [m/s]: MuJoCo puts a body to sleep after ten steps below this speed. Bodies that stay awake creep by
# hundredths of a millimeter.
SLEEP = 5e-4

# Time [s] at which velocities are set to zero if only balls are still moving; the remaining time shows whether they
# rest in a hollow.
CALM_S = 2.0


@dataclass(frozen=True, eq=False)
class SettledLayout:
    """The result of settling a layout.

    Attributes:
        state: Final state, rounded to the precision of documents.
        moved: Displacement of each free object [m].
        tilted: Tilt of each free object [deg]; 0 for balls.
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
    """Simulate a state until it comes to rest or the maximum settling time is reached.

    The world's model is reused; ``absent`` objects are ignored.
    """
    gone = set(absent)
    items = [o for o in world.scene.objects if not o.fixed and o.name not in gone]
    _let_sleep(world)
    world.reset(_without(world, state, gone))
    calmed: SceneState | None = None

    def watch(elapsed: float, moving: set[str]) -> bool:
        nonlocal calmed
        if moving and elapsed == CALM_S and all(is_ball(world.scene.object(name)) for name in moving):
            world.halt()  # a ball that stays in place from now on is in a hollow
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
        end = SceneState.of({**end.poses, **{n: state.poses[n] for n in gone}}, end.joints, end.motions)
    moved = {o.name: float(np.linalg.norm(end.poses[o.name].p - state.poses[o.name].p)) for o in items}
    tilted = {o.name: 0.0 if is_ball(o) else tilt_deg(state.poses[o.name], end.poses[o.name]) for o in items}
    return SettledLayout(end, moved, tilted, tuple(o.name for o in items if o.name in moving), deepest, between)


def _without(world: MujocoWorld, state: SceneState, absent: set[str]) -> SceneState:
    """Return the state with absent objects moved far away from the scene and from each other."""
    if not absent:
        return state
    away = {o.name: Pose.of((ELSEWHERE * (k + 1), 0.0, 0.0)) for k, o in enumerate(world.scene.objects)}
    return SceneState.of({**state.poses, **{n: away[n] for n in absent}}, state.joints, state.motions)


def _let_sleep(world: MujocoWorld) -> None:
    """Enable sleeping if available, so that bodies at rest are not simulated until MuJoCo wakes them on contact.

    Sleeping requires MuJoCo 3.4.
    """
    import mujoco

    sleep = getattr(mujoco.mjtEnableBit, "mjENBL_SLEEP", None)
    if sleep is not None:
        world.model.opt.enableflags |= int(sleep)
        world.model.opt.sleep_tolerance = SLEEP


def _is_asleep(world: MujocoWorld) -> bool:
    """Return whether all movable bodies are asleep."""
    return int(getattr(world.data, "ntree_awake", 1)) == 0
