"""What a thing must still be able to do: the part that it plays in the tasks of its scene."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

from simfoundry.scene.model import Scene, SceneObject
from simfoundry.spec.models.expressions import Call, parse_call, texts
from simfoundry.spec.models.predicate import Effect
from simfoundry.spec.models.scene import SceneSpec
from simfoundry.spec.models.task import TaskSpec


@dataclass(frozen=True, eq=False)
class Needs:
    """``rests``: calls of OnTop and Inside that the thing takes part in; ``joints`` that must move; ``opening`` [m] of
    the gripper that must take it, None where none must. ``others`` are the things that the calls name.
    """

    rests: tuple[Call, ...] = ()
    joints: tuple[str, ...] = ()
    opening: float | None = None
    others: Mapping[str, SceneObject] = field(default_factory=lambda: MappingProxyType({}))


def needs_of(name: str, spec: SceneSpec, scene: Scene, tasks: Sequence[TaskSpec]) -> Needs:
    """What the tasks ask of the object ``name``, and, without any, what it does in its scene as it is."""
    calls = list(dict.fromkeys(c for task in tasks for c in _calls(task)))
    mine = [c for c in calls if any(argument.partition(".")[0] == name for argument in c.args)]
    known = {item.name: item for item in scene.objects}
    rests = [
        c for c in mine if c.declaration.effect is Effect.PLACE and all(a.partition(".")[0] in known for a in c.args)
    ]
    carried = any(c.declaration.effect.grasps and c.args[0].partition(".")[0] == name for c in mine)
    joints = tuple(j.name for j in known[name].joints if j.has_axis and j.limits is not None)
    others = {o: known[o] for c in rests for a in c.args if (o := a.partition(".")[0]) != name}
    opening = _opening(spec) if carried else None
    return Needs(tuple(rests), joints, opening, MappingProxyType(others))


def _calls(task: TaskSpec) -> Iterator[Call]:
    for goal in (task.goal, *(step.goal for step in task.subtasks.values())):
        yield from _wanted(goal)


def _wanted(goal: Any) -> Iterator[Call]:
    for text, path in texts(goal):
        if "not" not in path:
            yield parse_call(text)


def _opening(spec: SceneSpec) -> float | None:
    """The widest that a robot of the scene opens its gripper [m]; None where it is not known."""
    found = []
    for robot in spec.robots.values():
        known = robot.known()
        found.append(robot.opening or (known.opening if known is not None else None))
    return max((o for o in found if o is not None), default=None)
