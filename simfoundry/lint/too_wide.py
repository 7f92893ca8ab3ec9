"""SF407: objects that a task requires to be carried and that are too wide for every robot's gripper."""

from __future__ import annotations

import math
from collections.abc import Iterator

from simfoundry.lint.lints import Lint, Subject
from simfoundry.lint.report import warning
from simfoundry.scene.lengths import length
from simfoundry.scene.object_shapes import solid
from simfoundry.scene.state import SceneState
from simfoundry.spec.diagnostics import Diagnostic
from simfoundry.spec.models.robot import RobotSpec

SLACK = 0.001
"""Excess width [m] over the opening that still fits: openings are given in whole millimeters."""


def too_wide(subject: Subject) -> Iterator[Diagnostic]:
    """Find objects to be carried whose narrowest width exceeds the opening of every robot."""
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
        item = next((item for item in draft.solids if item.name == name), None)
        width = 0.0 if item is None else grasp_width(solid(item, SceneState.initial(draft.scene)))
        if width <= widest + SLACK:
            continue
        if math.isfinite(width):
            message = f"`{name}` is {length(width)} wide at its narrowest, and `{robot}` opens {length(widest)}"
        else:
            message = f"`{name}` has no grasp from above for two fingers; `{robot}` opens {length(widest)}"
        hint = "make it narrower, give it a handle or a rim, or turn it; `opening` states the opening of a robot"
        yield warning(subject.loaded, "SF407", path, message, hint, (name, robot))


def acting_robots(subject: Subject) -> dict[str, RobotSpec]:
    """Return the robots that act in a task, by name."""
    wanted = subject.task.robots
    return {n: r for n, r in subject.scene.spec.robots.items() if wanted is None or n in wanted}


def _opening(robot: RobotSpec) -> float | None:
    known = robot.known()
    return robot.opening or (known.opening if known is not None else None)


LINT = Lint("SF407", ("task/1",), too_wide)
