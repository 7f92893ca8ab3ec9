"""Search for a witness of a goal, which is a state at rest in which the goal is true.

Feasibility is demonstrated by simulation. Objects are dropped onto the collision geometry in a few dozen positions and
orientations and simulated until they come to rest. Then the goal is evaluated. Robot motion is not planned. Separate
tests determine if each object can be grasped and if its target can be reached.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from itertools import product
from typing import Any

import numpy as np

from simfoundry.cousins.recipe.candidate import Reason
from simfoundry.cousins.tasks.candidate_poses import branches, cavity_words, levels, objects_of, places, spots, turns
from simfoundry.cousins.tasks.context import TaskContext
from simfoundry.cousins.tasks.trial import dropped, lost, open_end, put, rest, standing, turned
from simfoundry.geometry.frames import Pose
from simfoundry.predicates import PredicateError, Verdict
from simfoundry.predicates.judging.bodies import Bodies
from simfoundry.scene.carriers import PlaceError
from simfoundry.scene.state import SceneState
from simfoundry.spec.models.predicate import Call, parts

ON = ("OnTop", "Inside", "Touching", "Above")
BESIDE = ("NextTo", "LeftOf", "RightOf", "InFrontOf", "Behind")
# Predicates made true by placing their first argument.
PUT = (*ON, *BESIDE, "At", "Upright")

JOINTS = ("Open", "Closed")
# Predicates made true only by a hand holding the object.
HELD = ("Grasped", "Lifted")

# Predicates allowed in a goal; `Released` may be combined with them.
ALLOWED = (*PUT, "Under", *JOINTS, *HELD)

# Margin [m] by which an object may violate a predicate at first contact, because it may satisfy the predicate after
# settling.
NEAR = 0.03

# Number of simulations per object after which placing it is considered impossible.
SETTLES = 6

# Number of orientations to try at each position after the first two.
FEW = 3


@dataclass(frozen=True, eq=False)
class Witness:
    """A state at rest in which a goal is true, and the joints that had to be opened to reach it."""

    state: SceneState
    opened: tuple[str, ...] = ()


@dataclass
class _Attempt:
    """An attempt to make a goal true.

    Attributes:
        state: Current state.
        held: Link that supports each placed object, as ``owner.link``, keyed by object name.
        opened: Names of opened joints.
        barred: Negated conditions in the goal, along with the object that each condition concerns.
    """

    state: SceneState
    held: dict[str, str] = field(default_factory=dict)
    opened: list[str] = field(default_factory=list)
    barred: list[tuple[str, Any]] = field(default_factory=list)

    def asked(self, name: str, calls: list[Call]) -> Any:
        """Return the condition that a placed object must satisfy.

        It combines all ``calls`` with all negated conditions on it.
        """
        return {"all": [*(str(call) for call in calls), *(term for owner, term in self.barred if owner == name)]}


def witness(setting: TaskContext, goal: Any) -> Witness | tuple[Reason, ...]:
    """Find a witness of a goal.

    The names and predicates in the goal must be valid. If the search fails, the reasons are returned.
    """
    refused: tuple[Reason, ...] = ()
    for way in branches(goal):
        try:
            found = _made(setting, goal, way)
        except PredicateError as error:
            found = (Reason("impossible", str(error)),)
        if isinstance(found, Witness):
            return found
        refused = refused or found
    return refused


def _made(setting: TaskContext, goal: Any, way: list[Call]) -> Witness | tuple[Reason, ...]:
    attempt = _Attempt(setting.twin.state, barred=list(_barred(goal)))
    way = [Call("Above", call.args[::-1]) if call.predicate == "Under" else call for call in way]
    for call in way:
        if call.predicate in HELD and (lacks := setting.cannot_take(call.args[0].partition(".")[0])):
            return lacks
    todo = [call for call in way if not setting.twin.judge(str(call), attempt.state).value]
    for call in todo:
        if call.predicate == "Open" and (lacks := _set(setting, attempt, call)):
            return lacks
    for name, calls in _in_order([call for call in todo if call.predicate in PUT]):
        if lacks := _put(setting, attempt, name, calls):
            return lacks
    for call in way:
        shut = call.predicate != "Closed" or setting.twin.judge(str(call), attempt.state).value
        if not shut and (lacks := _set(setting, attempt, call)):
            return lacks
    if not any(call.predicate in HELD for call in way):
        verdict = setting.twin.judge(goal, attempt.state)
        if not verdict.value:
            text = f"its conditions cannot all hold at once: {verdict.why}"
            return (Reason("impossible", text, {"m": verdict.margin}),)
        if gone := lost(setting, goal, attempt.state):
            return (Reason("fleeting", f"it does not last: {gone}"),)
    return Witness(attempt.state, tuple(attempt.opened))


def _barred(goal: Any) -> Iterator[tuple[str, Any]]:
    """Yield the negated conditions in a goal, each with the first object that it refers to."""
    tag, below = parts(goal)
    if tag == "all":
        for item in below:
            yield from _barred(item)
    elif tag == "not" and (names := objects_of(goal)):
        yield names[0], goal


def _in_order(calls: list[Call]) -> Iterator[tuple[str, list[Call]]]:
    """Yield the objects to place along with their predicates. Containers and supports come first."""
    waiting: dict[str, list[Call]] = {}
    for call in calls:
        waiting.setdefault(call.args[0].partition(".")[0], []).append(call)
    while waiting:
        free = [n for n, asked in waiting.items() if not {_owner(c) for c in asked} & (waiting.keys() - {n})]
        for name in free or list(waiting)[:1]:
            yield name, waiting.pop(name)


def _owner(call: Call) -> str:
    return call.args[1].partition(".")[0] if len(call.args) > 1 and call.kinds[1] != "number" else ""


# -- joints -----------------------------------------------------------------------------------------------------------


def _set(setting: TaskContext, attempt: _Attempt, call: Call) -> tuple[Reason, ...]:
    """Open or close the joints to which a predicate refers.

    Returns:
        The reasons if this fails, or an empty tuple.
    """
    owner = call.args[0].partition(".")[0]
    joints = setting.joints(call.args[0])
    for joint in joints:
        end = open_end(setting, owner, joint, call.predicate)
        if end is None:
            text = f"`{owner}.{joint.name}` can never be {call.predicate.lower()}: its limits are {joint.limits}"
            return (Reason("impossible", text),)
        low, high = setting.bounds(f"{owner}.{joint.child}", attempt.state)
        if lacks := setting.cannot_reach(f"{owner}.{joint.child}", low, high):
            return lacks
        attempt.state = turned(setting, owner, joint, end, attempt.held, attempt.state)
    settled = rest(setting, attempt.state, {owner, *attempt.held})
    if settled.why:
        return (Reason("impossible", f"{call} cannot be achieved: {settled.why}"),)
    attempt.state = settled.state
    verdict = setting.twin.judge(str(call), attempt.state)
    text = f"{call} does not last: {verdict.why}"
    return () if verdict.value else (Reason("impossible", text, {"margin": verdict.margin}),)


# -- objects ----------------------------------------------------------------------------------------------------------


def _put(setting: TaskContext, attempt: _Attempt, name: str, calls: list[Call]) -> tuple[Reason, ...]:
    """Place an object so that all ``calls`` hold, opening closed joints if necessary.

    Returns:
        The reasons if the object cannot be placed, or an empty tuple.
    """
    if lacks := setting.cannot_take(name):
        return lacks
    below = next((_owner(call) for call in calls if _owner(call) in setting.twin.riders(name)), "")
    if below:
        return (Reason("impossible", f"`{name}` cannot be placed there, because `{below}` stands on it"),)
    shut = [joint for call in calls if call.predicate in ON for joint in _shut(setting, attempt, call.args[1])]
    within = any("." in call.args[1] for call in calls if call.predicate in ON)
    lacks = _tried(setting, attempt, name, calls) if not (shut and within) else ()
    if not shut or not (lacks or within):
        return lacks
    before, shut = attempt.state, list(dict.fromkeys(shut))
    failed = next(filter(None, (_set(setting, attempt, Call("Open", (joint,))) for joint in shut)), ())
    if failed := failed or _tried(setting, attempt, name, calls):
        attempt.state = before
        return lacks or failed
    attempt.opened += shut
    return ()


def _shut(setting: TaskContext, attempt: _Attempt, target: str) -> list[str]:
    """Return the closed joints of the target part or object, as ``object.joint``."""
    joints = [f"{target.partition('.')[0]}.{joint.name}" for joint in setting.joints(target)]
    return [joint for joint in joints if not setting.twin.judge(f"Open({joint})", attempt.state).value]


def _tried(setting: TaskContext, attempt: _Attempt, name: str, calls: list[Call]) -> tuple[Reason, ...]:
    """Try candidate poses for an object until its predicates hold at rest.

    Poses in which the predicates hold at first contact are simulated first. If none of them succeeds, poses in which
    the predicates nearly hold are also simulated.

    Returns:
        The reasons if no pose succeeds, or an empty tuple.
    """
    tried = _Tried()
    nearly: list[tuple[float, SceneState]] = []
    try:
        for state, verdict in _touchdowns(setting, attempt, name, calls, tried):
            if not verdict.value:
                nearly.append((verdict.margin, state))
            elif _settled(setting, attempt, name, calls, state, tried):
                return ()
        for state in _unlike(nearly, name):
            if tried.settles >= SETTLES:
                break
            if _settled(setting, attempt, name, calls, state, tried):
                return ()
    except PredicateError as error:
        return (Reason("impossible", str(error)),)
    return tried.far or (_cannot(setting, name, calls, tried),)


def _unlike(nearly: list[tuple[float, SceneState]], name: str) -> Iterator[SceneState]:
    """Yield the states in which predicates nearly hold, in order of increasing violation.

    States with equal position and violation differ only in the object's rotation, so all but the first are skipped.
    """
    seen = set()
    for margin, state in sorted(nearly, key=lambda row: -row[0]):
        key = (round(margin, 3), *np.round(state.poses[name].p, 2).tolist())
        if margin >= -NEAR and key not in seen:
            seen.add(key)
            yield state


@dataclass
class _Tried:
    """Statistics on the attempts to place an object.

    Attributes:
        puts: Number of poses tried.
        settles: Number of simulations.
        best: Best margin of the predicates.
        why: Explanation of the best failure or of the most recent failure.
        far: Reasons why no hand can reach a pose at which the predicates hold.
        unreached: Positions that no hand can reach, rounded to 1 cm [m].
    """

    puts: int = 0
    settles: int = 0
    best: float = -np.inf
    why: str = ""
    far: tuple[Reason, ...] = ()
    unreached: set[tuple[float, ...]] = field(default_factory=set)


def _touchdowns(
    setting: TaskContext, attempt: _Attempt, name: str, calls: list[Call], tried: _Tried
) -> Iterator[tuple[SceneState, Verdict]]:
    """Yield states in which an object first touches its support, along with the verdict on its predicates."""
    asked = attempt.asked(name, calls)
    for pose in _landings(setting, attempt, name, calls):
        if tried.settles >= SETTLES:
            return
        tried.puts += 1
        try:
            state = put(setting, name, pose(), attempt.state)
        except PlaceError as error:
            tried.why = tried.why or error.message
            continue
        verdict = setting.twin.judge(asked, state)
        if verdict.margin > tried.best:
            tried.best, tried.why = verdict.margin, verdict.why
        yield state, verdict


def _settled(
    setting: TaskContext, attempt: _Attempt, name: str, calls: list[Call], state: SceneState, tried: _Tried
) -> bool:
    """Settle an object and check its predicates.

    If the predicates hold, the resulting state is stored in the attempt and True is returned.
    """
    spot = tuple(np.round(state.poses[name].p, 2).tolist())
    if spot in tried.unreached:
        return False
    if lacks := setting.cannot_hold(name, state):
        tried.unreached.add(spot)
        tried.far = tried.far or lacks
        return False
    tried.settles += 1
    asked = attempt.asked(name, calls)
    settled = rest(setting, state, {name, *setting.twin.riders(name)})
    verdict = setting.twin.judge(asked, settled.state)
    why = settled.why or ("" if verdict.value else f"at rest, {verdict.why}")
    if why := why or lost(setting, asked, settled.state):
        tried.why = why
        return False
    if lacks := setting.cannot_hold(name, settled.state):
        tried.far = tried.far or lacks
        return False
    attempt.state = settled.state
    bodies = Bodies(setting.twin.scene)
    for thing in (bodies.thing(call.args[1]) for call in calls if call.predicate in ON):
        attempt.held[name] = f"{thing.owner}.{bodies[thing.owner].item.links[thing.links[0]].name}"
    return True


def _landings(setting: TaskContext, attempt: _Attempt, name: str, calls: list[Call]) -> Iterator[Callable[[], Pose]]:
    """Yield functions that compute candidate poses.

    In the first poses, the object touches the target from above. In the remaining poses, it stands on one of the
    target's level surfaces.
    """
    target, within = _carrier(setting, name, calls)
    every = turns(setting, name)
    for k, xy in enumerate(places(setting, calls[0], attempt.state)):
        for q in every if k < 2 else every[:FEW]:
            yield partial(dropped, setting, name, target, within, xy, q, attempt.state)
    for level in levels(setting, target, attempt.state) if calls[0].predicate in ON else ():
        for xy, q in product(spots(level), every[:FEW]):
            yield partial(standing, setting, name, level, xy, q)


def _carrier(setting: TaskContext, name: str, calls: list[Call]) -> tuple[str, bool]:
    """Return the support on which to place an object.

    A flag is also returned. It is True if the object must be inside the support.
    """
    first = calls[0]
    if first.predicate in ON:
        return first.args[1], first.predicate == "Inside"
    beside = _owner(first)
    carried = setting.twin.carried.get(beside) or setting.twin.carried.get(name) or (setting.twin.ground,)
    return carried[0], False


def _cannot(setting: TaskContext, name: str, calls: list[Call], tried: _Tried) -> Reason:
    low, high = setting.bounds(name)
    size = " x ".join(f"{100 * v:.1f}" for v in (high - low).tolist())
    asked = " and ".join(str(call) for call in calls)
    text = f"{asked} did not become true in {tried.puts} placements of `{name}` ({size} cm)"
    text += cavity_words(setting, calls[0].args[1]) if calls[0].predicate == "Inside" else ""
    margin = {"margin": float(tried.best)} if np.isfinite(tried.best) else {}
    return Reason("impossible", f"{text}: {tried.why}" if tried.why else text, {"tries": tried.puts, **margin})
