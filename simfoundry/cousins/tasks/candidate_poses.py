"""Candidate orientations and positions for placing objects, and helpers for analyzing goals."""

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
from simfoundry.geometry.shapes import Sphere
from simfoundry.predicates.judging.bodies import Bodies
from simfoundry.predicates.relative import AXES, viewer_axis
from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.state import SceneState
from simfoundry.spec.models.predicate import Call, parse_call, parts, texts

QUARTER = math.pi / 2  # a quarter turn [rad]
# Roll and pitch [rad] relative to an object's standing orientation: unchanged, lying on each of four sides, and upside
# down.
TILTS = ((0.0, 0.0), (0.0, QUARTER), (0.0, -QUARTER), (QUARTER, 0.0), (-QUARTER, 0.0), (math.pi, 0.0))

YAWS = (0.0, QUARTER, QUARTER / 2)
# Positions above a target to try in addition to the centers of the target and its cavity, as fractions of its extents.
# They are the first six points of the Halton sequence with bases 2 and 3, which cover any rectangle evenly.
SPREAD = np.array([(1 / 2, 1 / 3), (1 / 4, 2 / 3), (3 / 4, 1 / 9), (1 / 8, 4 / 9), (5 / 8, 7 / 9), (3 / 8, 2 / 9)])

# Displacement [m] up to which an object is considered unmoved, equal to the height tolerance of a level surface.
STILL = 1e-3

# Gaps between objects placed beside each other [m].
GAPS = (0.02, 0.05, 0.1)

# Sides to try, in this order, for an object that must be next to another object.
AROUND = ("Behind", "InFrontOf", "LeftOf", "RightOf")


def turns(setting: TaskContext, name: str) -> list[Array]:
    """Return the orientations of an object to try, starting with the orientation in which it stands.

    Returns:
        Quaternions (w, x, y, z).
    """
    item = setting.twin.scene.object(name)
    standing = Pose.of(q=setting.twin.state.poses[name].q)
    is_round = all(isinstance(c.geometry, Sphere) for link in item.links for c in link.colliders)
    tilts = [Pose.of(q=quat_from_rpy(roll, pitch, 0.0)) for roll, pitch in TILTS]
    yaws = [Pose.of(q=quat_from_rpy(0.0, 0.0, yaw)) for yaw in YAWS]
    return [(yaw @ tilt @ standing).q for tilt, yaw in product(tilts, yaws)][: 1 if is_round else None]


def places(setting: TaskContext, call: Call, state: SceneState) -> list[tuple[float, float]]:
    """Return the positions of an object's center to try for a predicate, starting with the most promising one.

    The positions are x and y in the world [m].
    """
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
    """Return the level surfaces of an object, from highest to lowest.

    The result is empty for objects with only one level surface, for links, and for objects that have moved from their
    pose in the twin.
    """
    X_WO = setting.twin.state.poses.get(target)  # None for links
    if X_WO is None or not np.allclose(X_WO.p, state.poses[target].p, atol=STILL):
        return ()
    found = setting.twin[target].levels[::-1]
    return found if len(found) > 1 else ()


def spots(level: Support) -> Iterator[tuple[float, float]]:
    """Yield positions on a level surface as x and y in the world [m], starting with its center."""
    yield level.middle
    low, high = level.bounds
    yield from map(tuple, (low + SPREAD * (high - low)).tolist())


def hollow(setting: TaskContext, target: str, state: SceneState) -> Array | None:
    """Return the center of a target's cavity in the world [m], as an array of shape (3,).

    The result is None if the target has no cavity.
    """
    owner = target.partition(".")[0]
    for link, found in cavities(setting, target):
        item = setting.twin.scene.object(owner)
        X_OL = link_poses(item, state.of_object(item))[link]
        return np.asarray((state.poses[owner] @ X_OL).apply(found.middle))
    return None


def cavities(setting: TaskContext, target: str) -> list[tuple[str, Cavity]]:
    """Return the cavities of the links to which a target refers, along with the name of each link."""
    bodies = Bodies(setting.twin.scene)
    thing = bodies.thing(target)
    body = bodies[thing.owner]
    forms = [(body.item.links[k].name, form) for k in thing.links if (form := body.forms[k]) is not None]
    return [(link, found) for link, form in forms if (found := cavity(form)) is not None]


def is_free(setting: TaskContext, owner: str, link: str, point: Array) -> bool:
    """Return True if a point in a link's frame [m] is outside all parts of the link. The point has shape (3,)."""
    body = Bodies(setting.twin.scene)[owner]
    parts = [form.parts for form in [body.forms[body.index(link)]] if form is not None]
    return all(float(outside_part(p, k, point[None])[0]) > 0 for p in parts for k in range(len(p.radius)))


def cavity_words(setting: TaskContext, target: str) -> str:
    """Return a phrase that describes the size of an object's cavity.

    The phrase is empty if the object has no cavity.
    """
    for _, found in cavities(setting, target):
        return f"; the cavity is {100 * across(found):.1f} cm across and {100 * found.deep:.1f} cm deep"
    return ""


def across(hole: Cavity) -> float:
    """Return the largest width of a cavity [m], as estimated from its bounding sphere."""
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


# Symmetric predicates.
SYMMETRIC = ("NextTo", "Touching")

# Predicates that are equivalent to another predicate with its arguments swapped.
MIRRORED = {"Under": "Above", "RightOf": "LeftOf", "InFrontOf": "Behind"}

# Predicates that already require the first argument to be released, so that `Released` is redundant.
AT_REST = ("OnTop", "Inside")

Meaning = tuple[Any, ...]


def meaning(goal: Any) -> Meaning:
    """Return the normal form of a goal.

    Goals that differ only in order, repetition, synonyms or a redundant `Released` have the same normal form.

    Raises:
        ExpressionError: The goal contains an invalid expression.
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
    """Return the predicates that must all be true. Predicates inside ``any`` and ``not`` are excluded."""
    tag, below = parts(condition)
    if tag == "text":
        return [parse_call(condition)]
    return [call for item in below for call in conjuncts(item)] if tag == "all" else []


def objects_of(condition: Any) -> tuple[str, ...]:
    """Return the names of the objects and robots in a goal, in order of appearance."""
    calls = [parse_call(text) for text, _ in texts(condition)]
    named = [arg for call in calls for arg, kind in zip(call.args, call.kinds, strict=True) if kind != "number"]
    return tuple(dict.fromkeys(name.partition(".")[0] for name in named))


def goal_words(condition: Any) -> str:
    """Format a goal as a single line.

    An example is ``OnTop(cup, shelf) and not Inside(cup, shelf)``.
    """
    tag, below = parts(condition)
    if tag == "text":
        return str(condition)
    if tag == "not":
        return f"not {goal_words(below[0])}"
    words = {"all": " and ", "any": " or "}[tag].join(goal_words(item) for item in below)
    return f"({words})" if tag == "any" and len(below) > 1 else words


def branches(condition: Any) -> list[list[Call]]:
    """Return alternative lists of predicates such that all predicates in any one list together make a goal true.

    Negated conditions are ignored.
    """
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


# Maximum number of alternatives to try.
MOST = 8
