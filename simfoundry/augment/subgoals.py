"""The sub-goals of a task, and the object that each of them refers to.

Sub-goals are the sub-tasks of a task, followed by the parts of the goal that no sub-task covers. The reference of a
sub-goal is the object on which the hand acts: the object to grasp, the target of an object in the hand, or the link to
move. Motions are recorded and repeated relative to it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from simfoundry.evaluate.task import Task
from simfoundry.geometry.frames import IDENTITY, Pose
from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.model import Scene
from simfoundry.scene.state import SceneState, object_at
from simfoundry.spec.models.predicate import Call, Condition, Effect, parse_call, parts

# Effects in the order in which a predicate determines the reference of a condition with several predicates.
PRIORITY = (Effect.PLACE, Effect.JOINT, Effect.GRASP, Effect.MOVE, Effect.NONE)

WORLD = ""
"""The reference of a sub-goal that does not refer to an object, such as ``At(block, 0.4, 0)``."""


@dataclass(frozen=True)
class Subgoal:
    """A condition to achieve.

    Attributes:
        name: The name of the sub-task, or the text of the predicate if it is not a sub-task.
        condition: The condition.
        call: The predicate in the condition that determines the reference.
        reference: The object, or the link as ``object.link``, relative to which the hand moves; or :data:`WORLD`.
        held: The object that the hand holds on the way, or an empty string.
        robots: The robots that the condition names.
        is_implied: True if the task does not state the sub-goal, such as the grasp of an object that is to be placed.
    """

    name: str
    condition: Condition
    call: Call
    reference: str
    held: str = ""
    robots: tuple[str, ...] = ()
    is_implied: bool = False

    @property
    def lasts(self) -> bool:
        """True if the sub-goal still holds when the hand has moved on; a touch does not."""
        return _effect(self.call) is not Effect.NONE


def subgoals(task: Task) -> tuple[Subgoal, ...]:
    """Return the sub-goals of a task, in order.

    A sub-goal with the same reference as the next one is part of it: touching an object is part of grasping it.
    """
    found: list[Subgoal] = []
    held = ""
    for name, condition in _conditions(task):
        call = _leading(condition)
        if call is None:
            continue
        effect, first = _effect(call), call.args[0]
        if effect is Effect.PLACE and held != first and not _grasps(found, first):
            grasp = f"Grasped({first})"
            found.append(Subgoal(grasp, grasp, parse_call(grasp), first, is_implied=True))
        if effect is Effect.PLACE:
            held = first
        reference = _reference(task.scene, call)
        robots = tuple(dict.fromkeys(a for c in required_calls(condition) for a in c.args if a in task.robots))
        carries = effect is Effect.JOINT or (held == first and call.predicate != "Grasped")
        carried = held if carries else ""
        found.append(Subgoal(name, condition, call, reference, carried, robots))
        if effect is Effect.GRASP:
            held = first
        elif effect is Effect.PLACE:
            held = ""
    ordered = _grasped_when_placed(found)
    return tuple(one for k, one in enumerate(ordered) if not _is_part_of_next(one, ordered[k + 1 : k + 2]))


def _grasped_when_placed(found: list[Subgoal]) -> list[Subgoal]:
    """Move the grasp of an object, and what belongs to it, directly before the placement of the object.

    Tasks may list all grasps first, but a hand can hold only one object.
    """
    ordered = list(found)
    for place in found:
        if _effect(place.call) is not Effect.PLACE:
            continue
        before = ordered[: ordered.index(place)]
        mine = [one for one in before if one.reference == place.held]
        last = max((before.index(one) for one in mine), default=-1)
        others = [one for one in before[last + 1 :] if _effect(one.call) is Effect.GRASP]
        if mine and others:
            rest = [one for one in before if one not in mine]
            ordered = [*rest, *mine, *ordered[len(before) :]]
    return ordered


def _conditions(task: Task) -> Iterator[tuple[str, Condition]]:
    """Yield the name and the condition of each sub-task, and of each part of the goal that is not a sub-task."""
    stated = set()
    for name, subtask in task.subtasks.items():
        stated |= {str(call) for call in required_calls(subtask.goal)}
        yield name, subtask.goal
    for call in required_calls(task.goal):
        if str(call) not in stated and _effect(call) is not Effect.NONE:
            yield str(call), str(call)


def required_calls(condition: Condition) -> list[Call]:
    """Return the predicates that must hold: all of ``all``, and the first of ``any``."""
    kind, below = parts(condition)
    if kind == "text":
        return [parse_call(str(condition))]
    return [call for one in {"all": below, "any": below[:1]}.get(kind, ()) for call in required_calls(one)]


def _leading(condition: Condition) -> Call | None:
    """Return the predicate that determines the reference, or None if there is none."""
    calls = [call for call in required_calls(condition) if call.predicate != "Released"]
    return min(calls, key=lambda call: PRIORITY.index(_effect(call)), default=None)


def _effect(call: Call) -> Effect:
    """Return the effect of a predicate. A touch ends in a motion, but is none by itself."""
    return Effect.NONE if call.predicate == "Touching" else call.declaration.effect


def _grasps(found: list[Subgoal], name: str) -> bool:
    """Return True if the last sub-goal about an object is to grasp it."""
    about = [one for one in found if one.call.args[0] == name]
    return bool(about) and _effect(about[-1].call) is Effect.GRASP


def _reference(scene: Scene, call: Call) -> str:
    effect, names = _effect(call), {item.name for item in scene.objects}
    things = [argument for argument in call.args if argument.partition(".")[0] in names]
    if effect is Effect.PLACE or (effect is Effect.MOVE and len(things) > 1):
        return things[-1]
    if effect is Effect.MOVE:
        return WORLD
    return _moved_link(scene, things[0]) if effect is Effect.JOINT else things[0] if things else WORLD


def _moved_link(scene: Scene, text: str) -> str:
    """Return the link that moves with a joint, for the name of an object, a joint or a link."""
    owner, _, name = text.partition(".")
    for joint in scene.object(owner).joints:
        if joint.has_axis and name in ("", joint.name, joint.child):
            return f"{owner}.{joint.child}"
    return text


def _is_part_of_next(one: Subgoal, after: list[Subgoal]) -> bool:
    if not after or after[0].reference != one.reference or after[0].held != one.held:
        return False
    effects = _effect(one.call), _effect(after[0].call)
    may_merge = effects[0] is Effect.NONE or effects == (Effect.GRASP, Effect.GRASP)
    return may_merge and (not one.robots or not after[0].robots or one.robots == after[0].robots)


def reference_pose(scene: Scene, state: SceneState, reference: str) -> Pose:
    """Return the pose X_WR of a reference in a state."""
    if reference == WORLD:
        return IDENTITY
    owner, _, link = reference.partition(".")
    item = object_at(scene.object(owner), state)
    return item.X_WO @ link_poses(item)[link] if link else item.X_WO


def same_subgoal(one: Subgoal, other: Subgoal) -> bool:
    """Return True if two sub-goals, possibly of different tasks, are about the same objects."""
    return one.call == other.call and one.reference == other.reference
