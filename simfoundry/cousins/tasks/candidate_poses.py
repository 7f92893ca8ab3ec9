"""Candidate poses for placing objects: orientations, and positions at which they are released."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import product
from typing import Any

import numpy as np

from simfoundry.cousins.layout.supports import Support
from simfoundry.cousins.tasks.context import TaskContext
from simfoundry.geometry.cavity import Cavity, cavity, outside_part
from simfoundry.geometry.frames import Array, Pose, quat_from_rpy
from simfoundry.predicates.judging.bodies import Bodies
from simfoundry.predicates.relative import AXES, viewer_axis
from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.state import SceneState
from simfoundry.spec.models.predicate import Call, parse_call, parts, texts

QUARTER = math.pi / 2
TILTS = ((0.0, 0.0), (0.0, QUARTER), (0.0, -QUARTER), (QUARTER, 0.0), (-QUARTER, 0.0), (math.pi, 0.0))
"""Roll and pitch relative to an object's standing orientation: unchanged, on each of four sides, upside down."""

YAWS = (0.0, QUARTER, QUARTER / 2)
SPREAD = np.array([(1 / 2, 1 / 3), (1 / 4, 2 / 3), (3 / 4, 1 / 9), (1 / 8, 4 / 9), (5 / 8, 7 / 9), (3 / 8, 2 / 9)])
"""Positions over a target besides its center and that of its cavity, as shares of its extents: the first six points of
the Halton sequence with bases 2 and 3, which cover any rectangle evenly.
"""

STILL = 1e-3
"""Displacement [m] up to which an object counts as unmoved; levels have one height within a millimeter."""

GAPS = (0.02, 0.05, 0.1)
"""Gap between objects placed beside each other [m]."""

AROUND = ("Behind", "InFrontOf", "LeftOf", "RightOf")
"""Sides on which an object is tried that must be next to another, in this order."""


def turns(setting: TaskContext, name: str) -> list[Array]:
    """Orientations of an object to try as quaternions (wxyz), its standing orientation first."""
    item = setting.twin.scene.object(name)
    standing = Pose.of(q=setting.twin.state.poses[name].q)
    round_ = all(c.geometry.__class__.__name__ == "Sphere" for link in item.links for c in link.colliders)
    found = []
    for (roll, pitch), yaw in product(TILTS[:1] if round_ else TILTS, YAWS[:1] if round_ else YAWS):
        tilt = Pose.of(q=quat_from_rpy(roll, pitch, 0.0))
        found.append((Pose.of(q=quat_from_rpy(0.0, 0.0, yaw)) @ tilt @ standing).q)
    return found


def places(setting: TaskContext, call: Call, state: SceneState) -> list[tuple[float, float]]:
    """Positions of an object's center to try for a predicate: x, y in the world [m], the most likely first."""
    if call.predicate in AXES or call.predicate == "NextTo":
        return list(_beside(setting, call, state))
    if call.predicate == "At":
        return [(float(call.args[1]), float(call.args[2]))]
    if call.predicate == "Upright":
        low, high = setting.bounds(call.args[0], state)
        return [tuple(((low + high) / 2)[:2].tolist())]
    return list(_over(setting, call.args[1], state))


def _over(setting: TaskContext, target: str, state: SceneState) -> Iterator[tuple[float, float]]:
    hole = hollow(setting, target, state)
    if hole is not None:
        yield float(hole[0]), float(hole[1])
    low, high = setting.bounds(target, state)
    yield tuple(((low + high) / 2)[:2].tolist())
    yield from map(tuple, (low[:2] + SPREAD * (high - low)[:2]).tolist())


def levels(setting: TaskContext, target: str, state: SceneState) -> tuple[Support, ...]:
    """Return the levels of an object that has several, the highest first; empty if it is not at its pose in the twin.

    For a target that names a link, only levels of that link are returned.
    """
    X_WO = setting.twin.state.poses.get(target)  # links have no entry
    if X_WO is None or not np.allclose(X_WO.p, state.poses[target].p, atol=STILL):
        return ()
    found = setting.twin[target].levels[::-1]
    return found if len(found) > 1 else ()


def spots(level: Support) -> Iterator[tuple[float, float]]:
    """Yield positions on a level: x and y in the world [m], its center first."""
    yield level.middle
    low, high = level.bounds
    yield from map(tuple, (low + SPREAD * (high - low)).tolist())


def hollow(setting: TaskContext, target: str, state: SceneState) -> Array | None:
    """Center of the cavity of an object or link in the world [m], shape (3,); None without a cavity."""
    owner = target.partition(".")[0]
    for link, found in cavities(setting, target):
        item = setting.twin.scene.object(owner)
        X_OL = link_poses(item, state.of_object(item))[link]
        return np.asarray((state.poses[owner] @ X_OL).apply(found.middle))
    return None


def cavities(setting: TaskContext, target: str) -> list[tuple[str, Cavity]]:
    """Cavities of the links that a target names."""
    bodies = Bodies(setting.twin.scene)
    thing = bodies.thing(target)
    body = bodies[thing.owner]
    forms = [(body.item.links[k].name, form) for k in thing.links if (form := body.forms[k]) is not None]
    return [(link, found) for link, form in forms if (found := cavity(form)) is not None]


def is_free(setting: TaskContext, owner: str, link: str, point: Array) -> bool:
    """Return whether a point in a link's frame [m], shape (3,), is outside of all its parts."""
    body = Bodies(setting.twin.scene)[owner]
    form = body.forms[body.index(link)]
    parts = [] if form is None else range(len(form.parts.radius))
    return all(float(outside_part(form.parts, k, point[None])[0]) > 0 for k in parts if form is not None)


def cavity_words(setting: TaskContext, target: str) -> str:
    """Describe the size of an object's cavity as a phrase."""
    for _, found in cavities(setting, target):
        return f"; the cavity is {100 * across(found):.1f} cm across and {100 * found.deep:.1f} cm deep"
    return ""


def across(hole: Cavity) -> float:
    """Largest width of a cavity [m], from its bounding sphere."""
    return 2 * math.sqrt(max(hole.size**2 - (hole.deep / 2) ** 2, 0.0))


def _beside(setting: TaskContext, call: Call, state: SceneState) -> Iterator[tuple[float, float]]:
    low, high = setting.bounds(call.args[1], state)
    own = setting.bounds(call.args[0], state)
    half, mine = (high - low)[:2] / 2, (own[1] - own[0])[:2] / 2
    middle = ((low + high) / 2)[:2]
    ways = [AXES[call.predicate]] if call.predicate in AXES else [AXES[name] for name in AROUND]
    for gap, (column, sign) in product(GAPS, ways):
        way = sign * viewer_axis(setting.twin.scene.viewer, column)[:2]
        far = float(np.abs(way) @ (half + mine)) + gap
        yield tuple((middle + far * way).tolist())


SYMMETRIC = ("NextTo", "Touching")
"""Symmetric predicates."""

MIRRORED = {"Under": "Above", "RightOf": "LeftOf", "InFrontOf": "Behind"}
"""Predicates that equal another with its arguments swapped."""

AT_REST = ("OnTop", "Inside")
"""Predicates that already require the first argument to be released; Released adds nothing to them."""

Meaning = tuple[Any, ...]


def meaning(goal: Any) -> Meaning:
    """Return a goal's normal form, which ignores order, repetition, synonyms and an implied Released.

    Raises :class:`~simfoundry.spec.models.predicate.ExpressionError` if it is not a goal.
    """
    found = _reduced(goal)
    if found[0] != "all":
        return found
    resting = {term[2] for term in found[1:] if term[0] == "is" and term[1] in AT_REST}
    kept = tuple(t for t in found[1:] if not (t[0] == "is" and t[1] == "Released" and t[2] in resting))
    return kept[0] if len(kept) == 1 else ("all", *kept)


def _reduced(condition: Any) -> Meaning:
    tag, below = parts(condition)
    if tag == "text":
        return ("is", *_call(parse_call(condition)))
    terms = [_reduced(item) for item in below]
    if tag == "not":
        return terms[0][1] if terms[0][0] == "not" else ("not", terms[0])
    flat = [inner for term in terms for inner in (term[1:] if term[0] == tag else (term,))]
    unique = sorted(set(flat), key=repr)
    return unique[0] if len(unique) == 1 else (tag, *unique)


def _call(call: Call) -> tuple[str, ...]:
    name, args = call.predicate, call.args
    if name in MIRRORED:
        name, args = MIRRORED[name], args[::-1]
    if name in SYMMETRIC:
        args = tuple(sorted(args))
    return name, *(f"{float(a):.4f}" if kind == "number" else a for a, kind in zip(args, call.kinds, strict=True))


def conjuncts(condition: Any) -> list[Call]:
    """Return the predicates that must all become true; those below ``any`` and ``not`` are excluded."""
    tag, below = parts(condition)
    if tag == "text":
        return [parse_call(condition)]
    return [call for item in below for call in conjuncts(item)] if tag == "all" else []


def objects_of(condition: Any) -> tuple[str, ...]:
    """Names of the objects and robots in a goal, in its order."""
    calls = [parse_call(text) for text, _ in texts(condition)]
    named = [arg for call in calls for arg, kind in zip(call.args, call.kinds, strict=True) if kind != "number"]
    return tuple(dict.fromkeys(name.partition(".")[0] for name in named))


def goal_words(condition: Any) -> str:
    """Format a goal as one line: ``OnTop(cup, shelf) and not Inside(cup, shelf)``."""
    tag, below = parts(condition)
    if tag == "text":
        return str(condition)
    if tag == "not":
        return f"not {goal_words(below[0])}"
    words = {"all": " and ", "any": " or "}[tag].join(goal_words(item) for item in below)
    return f"({words})" if tag == "any" and len(below) > 1 else words


def branches(condition: Any) -> list[list[Call]]:
    """Return alternative sets of predicates that make a goal true; negated conditions are excluded."""
    tag, below = parts(condition)
    if tag == "text":
        return [[parse_call(condition)]]
    if tag == "not":
        return [[]]
    if tag == "any":
        return [way for item in below for way in branches(item)][:MOST]
    ways: list[list[Call]] = [[]]
    for item in below:
        ways = [[*way, *more] for way in ways for more in branches(item)][:MOST]
    return ways


MOST = 8
"""Maximum number of alternatives tried."""
