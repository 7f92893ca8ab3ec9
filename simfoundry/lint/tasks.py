"""Tasks that cannot be failed or cannot be done: goals true at the start (SF405), too wide (SF407), too far (SF408),
out of view (SF409)."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import product
from typing import Any, NamedTuple

from simfoundry.lint.frames import frame_of
from simfoundry.lint.report import Path_, warning
from simfoundry.lint.sketch import Changes, Sketch, sketch
from simfoundry.lint.things import Thing
from simfoundry.lint.verdicts import judge, verdict
from simfoundry.lint.views import unseen_of
from simfoundry.lint.widths import grasp_width
from simfoundry.scene.lengths import length, number
from simfoundry.spec.diagnostics import Diagnostic
from simfoundry.spec.loaded import Loaded
from simfoundry.spec.models.expressions import Call, parse_call, parts, texts
from simfoundry.spec.models.predicate import Effect
from simfoundry.spec.models.robot import RobotSpec
from simfoundry.spec.models.task import TaskSpec

SLACK = 0.001
"""A thing this much wider than the fingers open [m] still fits: openings are given in whole millimetres."""

Wanted = tuple[Call, Path_]


def lint_task(loaded: Loaded, spec: TaskSpec, scene: Loaded) -> Iterator[Diagnostic]:
    """Findings of a task in a scene, both without errors."""
    drawn = sketch(scene, Changes.of(spec.start))
    yield from _already_true(loaded, spec, scene, drawn)
    wanted = [w for goal, path in _goals(spec) for w in _conjuncts(goal, path)]
    to_do = [(call, path) for call, path in wanted if verdict(call, drawn).value is not True]
    robots = {n: r for n, r in drawn.spec.robots.items() if spec.robots is None or n in spec.robots}
    if robots:
        yield from _too_wide(loaded, drawn, robots, to_do)
        yield from _too_far(loaded, spec, drawn, robots, to_do)
    moved: dict[str, Path_] = {n: ("start", key, n) for key in ("place", "pose") for n in getattr(spec.start, key)}
    yield from unseen_of(loaded, drawn, [drawn.things[name] for name in moved], moved.__getitem__)


def _goals(spec: TaskSpec) -> Iterator[tuple[Any, Path_]]:
    yield spec.goal, ("goal",)
    for name, subtask in spec.subtasks.items():
        yield subtask.goal, ("subtasks", name, "goal")


def _conjuncts(condition: Any, path: Path_) -> Iterator[Wanted]:
    """The predicates that must all come true: not those below `any`, where another may, nor below `not`."""
    tag, below = parts(condition)
    if tag == "text":
        yield parse_call(condition), path
    elif tag == "all":
        for k, item in enumerate(below):
            yield from _conjuncts(item, (*path, tag, k))


# -- goals ----------------------------------------------------------------------------------------------------------


def _already_true(loaded: Loaded, spec: TaskSpec, scene: Loaded, drawn: Sketch) -> Iterator[Diagnostic]:
    """SF405 of the goal, and of steps that have a start of their own or are the first."""
    if _is_true(spec, spec.goal, drawn):
        why = judge(spec.goal, drawn).why
        yield _true_finding(loaded, ("goal",), "the goal is true at the start", why)
    for k, (name, subtask) in enumerate(spec.subtasks.items()):
        if subtask.start is None and k > 0:
            continue
        there = drawn if subtask.start is None else sketch(scene, Changes.of(spec.start, subtask.start))
        if _is_true(spec, subtask.goal, there):
            message = f"the step `{name}` is done at its start"
            yield _true_finding(loaded, ("subtasks", name, "goal"), message, judge(subtask.goal, there).why)


def _is_true(spec: TaskSpec, goal: Any, drawn: Sketch) -> bool:
    """Whether a goal is certainly true wherever a reset puts the things."""
    placed = {n.partition(".")[0] for text, _ in texts(goal) for n in _placed_by(parse_call(text))}
    return not (placed & spec.reset.objects.keys()) and judge(goal, drawn).value is True


def _placed_by(call: Call) -> tuple[str, ...]:
    """The things on whose position a predicate depends."""
    return call.args if call.declaration.effect in (Effect.MOVE, Effect.PLACE) else ()


def _true_finding(loaded: Loaded, path: Path_, message: str, why: str) -> Diagnostic:
    hint = "ask for what the robot must change, or start elsewhere"
    return warning(loaded, "SF405", path, f"{message}: {why}" if why else message, hint)


# -- what robots must get hold of -----------------------------------------------------------------------------------


def _too_wide(
    loaded: Loaded, drawn: Sketch, robots: dict[str, RobotSpec], wanted: list[Wanted]
) -> Iterator[Diagnostic]:
    """SF407: what must be carried, and of which no part fits between the fingers of any robot."""
    openings = {name: opening for name, robot in robots.items() if (opening := _opening(robot)) is not None}
    if len(openings) < len(robots):
        return
    name, widest = max(openings.items(), key=lambda item: item[1])
    seen = set[str]()
    for call, path in wanted:
        thing = drawn.things.get(call.args[0].partition(".")[0])
        if thing is None or not call.declaration.effect.grasps or thing.name in seen:
            continue
        seen.add(thing.name)
        width = grasp_width(thing) if thing.usable and thing.sure else 0.0
        if width > widest + SLACK:
            message = f"`{thing.name}` is {length(width)} wide at its narrowest, and `{name}` opens {length(widest)}"
            hint = "make it narrower, give it a handle or a rim, or turn it; `opening` says how far a robot opens"
            yield warning(loaded, "SF407", path, message, hint, (thing.name, name))


def _opening(robot: RobotSpec) -> float | None:
    known = robot.known()
    return robot.opening or (known.opening if known is not None else None)


class _Base(NamedTuple):
    """Where a robot stands along the ground [m], and how far from there it can grasp [m]."""

    name: str
    at: tuple[float, float]
    reach: float


def _bases(robots: dict[str, RobotSpec]) -> list[_Base]:
    """The robots; none where it is not known of each how far it reaches."""
    found = []
    for name, robot in robots.items():
        known = robot.known()
        reach = robot.reach or (known.reach if known is not None else None)
        if reach is None:
            return []
        x, y, _ = frame_of(robot.pose).p
        found.append(_Base(name, (x, y), reach))
    return found


def _too_far(
    loaded: Loaded, spec: TaskSpec, drawn: Sketch, robots: dict[str, RobotSpec], wanted: list[Wanted]
) -> Iterator[Diagnostic]:
    """SF408: what must be got to and is out of the reach of every robot, at the start or in a corner of its reset."""
    bases = _bases(robots)
    if not bases:
        return
    seen = set[str]()
    for call, path in wanted:
        for name in _needed(call):
            thing = drawn.things.get(name.partition(".")[0])
            if thing is None or not thing.usable or thing.name in seen:
                continue
            if thing.name in spec.reset.objects:
                seen.add(thing.name)
                yield from _far_corner(loaded, spec, thing, bases)
            elif (far := _nearest(bases, [_distance(b, thing, name) for b in bases])) is not None:
                seen.add(thing.name)
                yield _far_finding(loaded, path, name, *far)
        if call.predicate == "At":
            x, y = (float(v) for v in call.args[1:3])
            far = _nearest(bases, [math.dist((x, y), base.at) for base in bases])
            if far is not None:
                yield _far_finding(loaded, path, f"({x:g}, {y:g})", *far)


def _needed(call: Call) -> tuple[str, ...]:
    """The objects that a robot must get to: the first, and where it is to be placed."""
    effect = call.declaration.effect
    return () if effect is Effect.NONE else call.args if effect is Effect.PLACE else call.args[:1]


def _distance(base: _Base, thing: Thing, name: str) -> float:
    """How far the nearest bounds of a thing, or of the link that is meant, are from a base along the ground [m]."""
    pieces = thing.part(name.partition(".")[2])
    gaps = ([max(0.0, p.low[k] - base.at[k], base.at[k] - p.high[k]) for k in range(2)] for p in pieces)
    return min(math.hypot(*gap) for gap in gaps)


def _nearest(bases: list[_Base], distances: list[float]) -> tuple[_Base, float] | None:
    """Of the robots that are too far away the one that misses least, with its distance; None where one is near."""
    lacking, k = min((d - base.reach, k) for k, (base, d) in enumerate(zip(bases, distances, strict=True)))
    return (bases[k], distances[k]) if lacking > 0 else None


def _far_corner(loaded: Loaded, spec: TaskSpec, thing: Thing, bases: list[_Base]) -> Iterator[Diagnostic]:
    """The corner of a reset's region that is farthest out of reach."""
    region = spec.reset.objects[thing.name]
    x, y, _ = thing.X_WO.p
    around = max(math.dist((px, py), (x, y)) for px in _span(thing, 0) for py in _span(thing, 1))
    worst: tuple[float, _Base, float, tuple[float, float]] | None = None
    for corner in product(region.x, region.y):
        far = _nearest(bases, [math.dist(corner, base.at) - around for base in bases])
        if far is not None and (worst is None or far[1] - far[0].reach > worst[0]):
            worst = (far[1] - far[0].reach, *far, corner)
    if worst is not None:
        _, base, distance, (cx, cy) = worst
        name = f"{thing.name}` in the corner ({cx:g}, {cy:g}) of its region"
        path: Path_ = ("reset", "objects", thing.name)
        yield _far_finding(loaded, path, name, base, distance)


def _span(thing: Thing, k: int) -> tuple[float, float]:
    return thing.low[k], thing.high[k]


def _far_finding(loaded: Loaded, path: Path_, name: str, base: _Base, distance: float) -> Diagnostic:
    quoted = f"`{name}" if "`" in name else f"`{name}`"
    message = f"{quoted} is {distance:.2f} m from `{base.name}`, which reaches {number(base.reach)} m"
    hint = f"bring the two {length(distance - base.reach)} closer; `reach` says how far a robot can grasp"
    about = (name.partition("`")[0].partition(".")[0], base.name)
    return warning(loaded, "SF408", path, message, hint, about)
