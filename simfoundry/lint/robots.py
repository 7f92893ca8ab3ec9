"""Lints SF407 and SF408: objects that a task requires but that no gripper can grasp or no robot can reach."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from simfoundry.lint.draft import DraftScene
from simfoundry.lint.lints import Lint, Path_, Subject, warning
from simfoundry.scene.frames import FrameTree
from simfoundry.scene.lengths import length, number
from simfoundry.scene.object_shapes import link_bounds, solid
from simfoundry.scene.state import SceneState
from simfoundry.spec.diagnostics import Diagnostic
from simfoundry.spec.models.predicate import Call, Effect
from simfoundry.spec.models.robot import RobotSpec

if TYPE_CHECKING:
    from simfoundry.robots.reach import Hand, Miss

# Amount by which an object may be wider than the gripper opening [m], because openings are rounded to millimeters.
SLACK = 0.001


def too_wide(subject: Subject) -> Iterator[Diagnostic]:
    """Find objects that must be grasped but whose narrowest width exceeds the gripper opening of every robot."""
    from simfoundry.geometry.grasp_width import grasp_width

    draft, robots = subject.scene, acting_robots(subject)
    openings = {name: opening for name, robot in robots.items() if (opening := _opening(robot)) is not None}
    if not openings or len(openings) < len(robots):
        return
    robot, widest = max(openings.items(), key=lambda item: item[1])
    seen = set[str]()
    for call, path in subject.pending:
        name = call.args[0].partition(".")[0]
        if not call.declaration.effect.grasps or name in seen or name in draft.approximate:
            continue
        seen.add(name)
        subject.checkpoint()
        item = next((item for item in draft.solids if item.name == name), None)
        width = 0.0 if item is None else grasp_width(solid(item, SceneState.initial(draft.scene)), widest + SLACK)
        if width <= widest + SLACK:
            continue
        if math.isfinite(width):
            message = f"`{name}` is {length(width)} wide at its narrowest, but `{robot}` opens only {length(widest)}"
        else:
            message = f"`{name}` cannot be grasped from above with two fingers; `{robot}` opens {length(widest)}"
        hint = "make it narrower, give it a handle or a rim, or rotate it; `opening` sets how wide a gripper opens"
        yield warning(subject.loaded, "SF407", path, message, hint, (name, robot))


def acting_robots(subject: Subject) -> dict[str, RobotSpec]:
    """Return the robots that act in a task, by name."""
    wanted = subject.task.robots
    return {n: r for n, r in subject.scene.spec.robots.items() if wanted is None or n in wanted}


def _opening(robot: RobotSpec) -> float | None:
    known = robot.known()
    return robot.opening or (known.opening if known is not None else None)


TOO_WIDE = Lint("SF407", ("task/1",), too_wide)


def out_of_reach(subject: Subject) -> Iterator[Diagnostic]:
    """Find objects that must be reached but are out of reach initially or in a corner of their reset region."""
    from simfoundry.robots.reach import hands_of, nearest_miss

    draft, hands = subject.scene, hands_of(acting_robots(subject), FrameTree(subject.scene.spec))
    if not hands:
        return
    seen = set[str]()
    for call, path in subject.pending:
        for name in _needed(call):
            owner = name.partition(".")[0]
            if owner not in draft.bounds or owner in seen:
                continue
            if owner in subject.task.reset.objects:
                seen.add(owner)
                yield from _far_corner(subject, owner, hands)
            elif (miss := nearest_miss(hands, [_ground_distance(draft, hand, name) for hand in hands])) is not None:
                seen.add(owner)
                yield _reach_finding(subject, path, f"`{name}`", name, miss)
        if call.predicate == "At":
            x, y = (float(v) for v in call.args[1:3])
            miss = nearest_miss(hands, [math.dist((x, y), hand.at) for hand in hands])
            if miss is not None:
                yield _reach_finding(subject, path, f"`({x:g}, {y:g})`", "", miss)


def _needed(call: Call) -> tuple[str, ...]:
    """Return the arguments of a predicate that a robot must reach to make the predicate true."""
    effect = call.declaration.effect
    if effect is Effect.PLACE:
        return call.args
    return call.args[:1] if effect.moves_object or effect is Effect.JOINT else ()


def _ground_distance(draft: DraftScene, hand: Hand, name: str) -> float:
    """Return the horizontal distance [m] from a robot base to the bounding box of an object or one of its links."""
    owner, _, part = name.partition(".")
    at = np.array(hand.at)
    spans = [(low[:2], high[:2]) for low, high in link_bounds(draft.scene.by_name[owner], part)]
    return min(float(np.hypot(*np.maximum(0.0, np.maximum(low - at, at - high)))) for low, high in spans)


def _far_corner(subject: Subject, name: str, hands: tuple[Hand, ...]) -> Iterator[Diagnostic]:
    """Yield a finding for the corner of an object's reset region that is farthest out of reach, if there is one."""
    from simfoundry.robots.reach import nearest_miss

    region = subject.task.reset.objects[name]
    low, high = subject.scene.bounds[name]
    x, y, _ = subject.scene.scene.by_name[name].X_WO.p.tolist()
    around = max(math.dist(corner, (x, y)) for corner in product((low[0], high[0]), (low[1], high[1])))
    corners = [*product(region.x, region.y)]
    misses = [nearest_miss(hands, [math.dist(corner, hand.at) - around for hand in hands]) for corner in corners]
    found = [(miss, corner) for miss, corner in zip(misses, corners, strict=True) if miss is not None]
    if found:
        worst, (cx, cy) = max(found, key=lambda each: each[0].lacking)
        what = f"`{name}` in the corner ({cx:g}, {cy:g}) of its region"
        yield _reach_finding(subject, ("reset", "objects", name), what, name, worst)


def _reach_finding(subject: Subject, path: Path_, what: str, name: str, miss: Miss) -> Diagnostic:
    message = f"{what} is {miss.distance:.2f} m from `{miss.hand.name}`, which reaches {number(miss.reach)} m"
    hint = f"bring the two {length(miss.lacking)} closer together; `reach` sets how far a robot can grasp"
    return warning(subject.loaded, "SF408", path, message, hint, (name.partition(".")[0], miss.hand.name))


OUT_OF_REACH = Lint("SF408", ("task/1",), out_of_reach)
