"""Settling: from fitted poses, which overlap and float a little, to poses that rest.

First as the paper does it ("Object Depenetration and Physical Stability"): physics steps with all velocities set to
zero after each, until the poses stay, so that overlaps open without explosions. Then real dynamics until everything is
at rest, because a body that topples slowly looks still in the first phase. Where that does not end, because something
rolls away or falls off the edge, it is tried once more from the same poses, with the motion taken out again and again:
what cannot stand as it was fitted then falls over and lies where it stood.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from simfoundry.scene.frames import Pose
from simfoundry.scene.state import SceneState
from simfoundry.worlds.base import Contact, World

Progress = Callable[[str, float], None]

UPWARD = 0.5
"""A contact carries what lies above it if its normal points up by at least this much."""


@dataclass(frozen=True)
class SettleOptions:
    """When the phases end and what counts as passed.

    The quasi-static phase ends when nothing moved more than ``still_m`` or turned more than ``still_rad`` over
    ``window_s``, the dynamic one when the same holds over ``rest_s``; neither goes on longer than its ``max``. Where the
    motion is damped, it is taken out every ``damped_s``.
    """

    window_s: float = 0.1
    still_m: float = 1e-4
    still_rad: float = 1e-3
    max_quasi_static_s: float = 6.0
    min_dynamic_s: float = 1.0
    rest_s: float = 0.5
    max_dynamic_s: float = 8.0
    damped_s: float = 0.04
    max_damped_s: float = 6.0
    max_drift_m: float = 0.02
    max_tilt_deg: float = 5.0
    max_penetration_m: float = 0.001


@dataclass(frozen=True)
class ObjectSettle:
    """What settling did to one object.

    ``penetration_before`` and ``penetration_after`` [m] are its deepest contacts, ``drift`` [m] is how far it moved
    from its fitted pose, ``tilt_deg`` how far its up axis turned, ``turn_deg`` how far it turned at all. ``supports``
    names what carries it now; ``support_kept`` is False where an ``OnTop`` of the scene no longer holds.
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
        """Whether nothing is wrong with it."""
        return not self.problems


@dataclass(frozen=True, eq=False)
class Settled:
    """The poses at rest, what happened to each free object, and whether all of it came to rest in time."""

    state: SceneState
    objects: tuple[ObjectSettle, ...]
    at_rest: bool

    @property
    def passed(self) -> bool:
        """Whether everything came to rest and every object passed."""
        return self.at_rest and all(o.passed for o in self.objects)

    def to_json(self) -> dict[str, Any]:
        """A plain mapping for reports."""
        objects = [{**asdict(o), "passed": o.passed} for o in self.objects]
        return {"passed": self.passed, "at_rest": self.at_rest, "objects": objects}


def settle(world: World, options: SettleOptions | None = None, progress: Progress | None = None) -> Settled:
    """Settle the scene of a world from its own poses. The world is left in the settled state."""
    options = options or SettleOptions()
    world.reset()
    before, contacts_before = world.state(), world.contacts()
    _quasi_static(world, options, progress)
    opened = world.state()
    at_rest = _dynamic(world, options, progress)
    if not at_rest:
        world.reset(opened)
        _damped(world, options, progress)
        at_rest = _dynamic(world, options, progress)
    world.halt()
    after, contacts_after = world.state(), world.contacts()
    reports = tuple(
        _report(world, item.name, before, after, contacts_before, contacts_after, options)
        for item in world.scene.objects
        if not item.fixed
    )
    return Settled(after, reports, at_rest)


def motion(before: SceneState, after: SceneState) -> tuple[float, float]:
    """The largest displacement [m] and rotation [rad] of any object between two states."""
    moved = [float(np.linalg.norm(after.poses[n].p - before.poses[n].p)) for n in before.poses]
    turned = [after.poses[n].angle_to(before.poses[n]) for n in before.poses]
    return max(moved, default=0.0), max(turned, default=0.0)


def supporters(name: str, contacts: list[Contact]) -> tuple[str, ...]:
    """The objects that carry ``name``: those it touches from above."""
    below = {c.a for c in contacts if c.b == name and c.normal[2] >= UPWARD}
    below |= {c.b for c in contacts if c.a == name and c.normal[2] <= -UPWARD}
    return tuple(sorted(below))


def _quasi_static(world: World, options: SettleOptions, progress: Progress | None) -> None:
    steps = max(1, round(options.window_s / world.timestep))
    elapsed, last = 0.0, world.state()
    while elapsed < options.max_quasi_static_s:
        for _ in range(steps):
            world.step()
            world.halt()
        elapsed += steps * world.timestep
        now = world.state()
        moved, turned = motion(last, now)
        last = now
        if progress is not None:
            progress("depenetrate", elapsed / options.max_quasi_static_s)
        if moved <= options.still_m and turned <= options.still_rad:
            return


def _dynamic(world: World, options: SettleOptions, progress: Progress | None) -> bool:
    steps = max(1, round(options.rest_s / world.timestep))
    elapsed, last = 0.0, world.state()
    while elapsed < options.max_dynamic_s:
        world.step(steps)
        elapsed += steps * world.timestep
        now = world.state()
        moved, turned = motion(last, now)
        last = now
        if progress is not None:
            progress("rest", elapsed / options.max_dynamic_s)
        if elapsed >= options.min_dynamic_s and moved <= options.still_m and turned <= options.still_rad:
            return True
    return False


def _damped(world: World, options: SettleOptions, progress: Progress | None) -> None:
    """Dynamics in which nothing gathers speed: a fall is slow and a roll ends."""
    steps = max(1, round(options.damped_s / world.timestep))
    per_rest = max(1, round(options.rest_s / (steps * world.timestep)))
    elapsed, last = 0.0, world.state()
    while elapsed < options.max_damped_s:
        for _ in range(per_rest):
            world.step(steps)
            world.halt()
        elapsed += per_rest * steps * world.timestep
        now = world.state()
        moved, turned = motion(last, now)
        last = now
        if progress is not None:
            progress("calm", elapsed / options.max_damped_s)
        if moved <= options.still_m and turned <= options.still_rad:
            return


def _report(
    world: World,
    name: str,
    before: SceneState,
    after: SceneState,
    contacts_before: list[Contact],
    contacts_after: list[Contact],
    options: SettleOptions,
) -> ObjectSettle:
    start, end = before.poses[name], after.poses[name]
    drift = float(np.linalg.norm(end.p - start.p))
    tilt = _tilt_deg(start, end)
    penetration = _deepest(name, contacts_after)
    carried_by = supporters(name, contacts_after)
    wanted = [r.args[1] for r in world.scene.relations if r.predicate == "OnTop" and r.args[0] == name]
    kept = all(w in carried_by for w in wanted)
    problems = []
    if drift > options.max_drift_m:
        problems.append(f"moved {drift * 100:.1f} cm from its fitted pose")
    if tilt > options.max_tilt_deg:
        problems.append(f"tilted {tilt:.0f} deg")
    if penetration > options.max_penetration_m:
        problems.append(f"still penetrates by {penetration * 1000:.1f} mm")
    if not kept:
        problems.append(f"no longer on {', '.join(w for w in wanted if w not in carried_by)}")
    if not carried_by:
        problems.append("rests on nothing")
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


def _tilt_deg(start: Pose, end: Pose) -> float:
    """How far the body axis that pointed up at the start has turned from the vertical [deg]."""
    up = start.inverse().rotation @ np.array([0.0, 0.0, 1.0])
    return math.degrees(math.acos(float(np.clip((end.rotation @ up)[2], -1.0, 1.0))))
