"""Trials in MuJoCo: does a thing stand, hold what it held, fit where it lay, and do its joints still move."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from simfoundry.cousins.reasons import Reason
from simfoundry.geometry.frames import Pose, frozen_array
from simfoundry.geometry.shapes import Box
from simfoundry.predicates import Judge
from simfoundry.predicates.judging.bodies import PredicateError
from simfoundry.scene.model import Collider, Link, Scene, SceneObject, Visual
from simfoundry.scene.object_shapes import bounds
from simfoundry.scene.place import PlaceError, solve
from simfoundry.scene.state import SceneState
from simfoundry.spec.models.expressions import Call
from simfoundry.spec.models.place import Place
from simfoundry.worlds.mujoco_world import MujocoWorld
from simfoundry.worlds.settle import settle

TABLE = "trial_table"
GRAVITY = frozen_array([0.0, 0.0, -9.81])

STILL, LONGEST, LOOK = 0.01, 4.0, 0.25
"""A trial ends when nothing moves faster than this [m/s] between two looks, or after so many seconds."""

OPENED = 0.95
"""How far joints are opened for a trial, as a share of their range."""

STEPS = 9
"""Positions at which a joint's way is looked at."""

DEEPEST = 0.001
"""Links of one thing that interpenetrate deeper than this [m] jam."""

LEAST_RANGE = 0.75
"""Share of the twin's range that a joint keeps."""

TURNS = ((0.0, 0.0, 0.0), (0.0, 0.0, 90.0), (0.0, 90.0, 0.0), (90.0, 0.0, 0.0))
"""Ways to put a thing into another: as it is, across, on its end."""


@dataclass(frozen=True)
class Outcome:
    """What became of a trial; ``why`` says it with numbers."""

    passed: bool
    why: str


def stands(item: SceneObject) -> Outcome:
    """Whether a thing put on a table stays there, and does not topple when it is tilted a little."""
    placed = _on_table(item)
    if isinstance(placed, Outcome):
        return placed
    with MujocoWorld(_scene(placed)) as world:
        report = settle(world).objects[0]
    return Outcome(report.passed, "; ".join(report.problems) or f"moved {report.drift * 1000:.1f} mm")


def rests(call: Call, things: Mapping[str, SceneObject]) -> Outcome:
    """Whether ``OnTop(a, b)`` or ``Inside(a, b)`` holds after ``a`` was put there and let go, in any of some ways.

    ``things`` are ``a`` and ``b`` by name; the joints of ``b`` are opened.
    """
    a, b = call.args[0], call.args[1].partition(".")[0]
    base = _on_table(_opened(things[b]))
    if isinstance(base, Outcome):
        return base
    why = f"`{a}` finds no place {'inside' if call.predicate == 'Inside' else 'on'} `{call.args[1]}`"
    for place in _places(call, base):
        try:
            X_WA = solve(things[a], place, {base.name: base}, None)
        except PlaceError as error:
            why = error.message
            continue
        outcome = _let_go(call, replace(things[a], X_WO=X_WA, fixed=False), base)
        if outcome.passed:
            return outcome
        why = outcome.why
    return Outcome(False, why)


def _places(call: Call, base: SceneObject) -> Iterator[Place]:
    inside = call.predicate == "Inside"
    low, high = bounds(base)
    sides = (0.0, 0.25, -0.25) if not inside else (0.0,)
    for y in sides:
        for turn in TURNS if inside else TURNS[:2]:
            local_xy = None if y == 0 else (0.0, round(y * float(high[1] - low[1]), 4))
            rpy = turn if any(turn) else None
            place = Place(inside=call.args[1], rpy_deg=rpy) if inside else Place(on=call.args[1], rpy_deg=rpy)
            yield place if local_xy is None else place.model_copy(update={"local_xy": local_xy})


def _let_go(call: Call, a: SceneObject, b: SceneObject) -> Outcome:
    scene = _scene(b, a)
    with MujocoWorld(scene) as world:
        state = _calmed(world)
        try:
            verdict = Judge(scene)(str(call), state)
        except PredicateError as error:
            return Outcome(False, str(error))
        tilt = state.poses[b.name].rotation[2, 2]
    if tilt < np.cos(np.radians(5.0)):
        return Outcome(False, f"`{b.name}` tilted {np.degrees(np.arccos(np.clip(tilt, -1, 1))):.0f} deg under it")
    return Outcome(verdict.value, verdict.why)


def _calmed(world: MujocoWorld) -> SceneState:
    """The state once nothing moves any more, or after :data:`LONGEST` seconds."""
    steps = max(1, round(LOOK / world.timestep))
    for _ in range(round(LONGEST / LOOK)):
        world.step(steps)
        state = world.state()
        if max(state.speeds.values(), default=0.0) < STILL:
            break
    return state


def moves(item: SceneObject, twin: SceneObject) -> Reason | None:
    """Why a joint no longer moves as the twin's does: its range, or what it meets on its way; None where all do."""
    for joint in item.joints:
        own = next((j for j in twin.joints if j.name == joint.name), None)
        if joint.limits is None or own is None or own.limits is None:
            continue
        span, before = (limits[1] - limits[0] for limits in (joint.limits, own.limits))
        if span < LEAST_RANGE * before:
            text = f"`{joint.name}` moves {span:.3f}, and {before:.3f} in the twin"
            return Reason("joint", text, {"range": span, "twin": before})
    deepest, where = _jam(item)
    if deepest > DEEPEST and deepest > _jam(twin)[0] + 1e-4:
        text = f"its links overlap by {deepest * 1000:.1f} mm with {where}"
        return Reason("joint", text, {"overlap": deepest})
    return None


def _jam(item: SceneObject) -> tuple[float, str]:
    """The deepest overlap of two links of a thing [m] on the way of any of its joints, and where that is."""
    import mujoco

    worst, where = 0.0, "every joint closed"
    alone = replace(item, X_WO=Pose.of(), fixed=True)
    with MujocoWorld(_scene(alone)) as world:
        model, data = world.model, world.data
        ids = {link.name: model.body(item.qualified(link.name)).id for link in item.links}
        bodies = {k: name for name, k in ids.items()}
        geoms = [g for g in range(model.ngeom) if int(model.geom_bodyid[g]) in bodies and model.geom_contype[g]]
        pairs = [(g, h) for g in geoms for h in geoms if g < h and model.geom_bodyid[g] != model.geom_bodyid[h]]
        for joint in item.joints:
            if joint.limits is None:
                continue
            for position in np.linspace(*joint.limits, STEPS):
                world.reset(SceneState.of({}, {f"{item.name}.{joint.name}": float(position)}))
                for g, h in pairs:
                    distance = mujoco.mj_geomDistance(model, data, g, h, 1e-3, None)
                    if -distance > worst:
                        worst, where = -distance, f"`{joint.name}` at {position:.3f}"
    return worst, where


def _opened(item: SceneObject) -> SceneObject:
    """The thing with its joints at the far end of their range."""
    joints = tuple(
        replace(j, position=j.limits[0] + OPENED * (j.limits[1] - j.limits[0])) if j.limits is not None else j
        for j in item.joints
    )
    return replace(item, joints=joints)


def _on_table(item: SceneObject) -> SceneObject | Outcome:
    free = replace(item, fixed=False, variants=())
    try:
        X_WO = solve(free, Place(on=TABLE, local_xy=(0.0, 0.0)), {TABLE: _table()}, None)
    except PlaceError as error:
        return Outcome(False, error.message)
    return replace(free, X_WO=X_WO)


def _scene(*items: SceneObject) -> Scene:
    return Scene("trial", GRAVITY, (_table(), *items))


def _table() -> SceneObject:
    """A wide table whose top is at z = 0."""
    box = Box(frozen_array([3.0, 3.0, 0.1]))
    rgba = frozen_array([0.7, 0.7, 0.7, 1.0])
    inertia = frozen_array(np.eye(3))
    link = Link(
        "base",
        100.0,
        frozen_array(np.zeros(3)),
        inertia,
        (Visual("top", box, rgba),),
        (Collider("top", box, 0.5, 0.1),),
    )
    return SceneObject(TABLE, "table", True, Pose.of([0.0, 0.0, -0.05]), (link,))
