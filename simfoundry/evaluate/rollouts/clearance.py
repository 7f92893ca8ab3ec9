"""Distance bounds between bodies.

The bounds show that most goals cannot hold yet, so that exact distances need not be measured.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np

from simfoundry.predicates import Judge
from simfoundry.predicates.judging.bodies import Bodies
from simfoundry.predicates.judging.thresholds import TOUCH
from simfoundry.scene.model import JointType, Scene
from simfoundry.scene.state import SceneState
from simfoundry.spec.models.predicate import Call, parse_call, parts
from simfoundry.worlds.base import reach

# Distance [m] between a robot and an object up to which it is measured again only after WAIT states, because the robot
# would exceed the bound within a few states.
NEAR, WAIT = 0.1, 10


class Clearances:
    """A test for conditions that are false because the bodies to which they refer are too far apart to touch.

    Objects are compared by their bounding spheres. The distance between a robot and an object is measured once. The
    measurement remains valid until the joints and the object have moved so far that the two bodies may touch.
    """

    def __init__(self, scene: Scene, judge: Judge) -> None:
        self._scene, self._judge, self._bodies = scene, judge, Bodies(scene)
        self._rigid = {item.name: reach(item) for item in scene.objects if not item.joints}
        self._parsed = cache(parse_call)
        self._levers = cache(lambda robot: _levers(self._bodies, robot))
        # By robot and object: the state in which their distance was measured, the distance [m], and the states to skip.
        self._measured: dict[tuple[str, str], tuple[SceneState, float, int]] = {}

    def excludes(self, condition: Any, state: SceneState) -> bool:
        """Return True if a condition is certainly false in a state."""
        tag, below = parts(condition)
        if tag == "text":
            return self._excludes(self._parsed(str(condition)), state)
        if tag == "all":
            return any(self.excludes(part, state) for part in below)
        return tag == "any" and bool(below) and all(self.excludes(part, state) for part in below)

    def _excludes(self, call: Call, state: SceneState) -> bool:
        if not call.declaration.contact:
            return False
        owners = [argument.partition(".")[0] for argument in call.args]
        robots = [name for name in owners if name in self._bodies.robots]
        objects = [name for name in owners if name in self._rigid]
        if len(robots) + len(objects) < len(owners) or not objects or not set(self._bodies.robots) <= set(state.robots):
            return False
        if len(objects) == 2:
            a, b = objects
            return math.dist(state.poses[a].p, state.poses[b].p) > self._rigid[a] + self._rigid[b] + TOUCH
        return all(self._apart(robot, objects[0], state) for robot in robots or self._bodies.robots)

    def _apart(self, robot: str, name: str, state: SceneState) -> bool:
        """Return True if a robot is certainly too far from an object to touch it."""
        before, gap, wait = self._measured.get((robot, name), (state, 0.0, 0))
        if gap - self._moved(robot, name, before, state) > TOUCH:
            return True
        if wait > 0:
            self._measured[robot, name] = before, gap, wait - 1
            return False
        gap = TOUCH - self._judge(f"Touching({robot}, {name})", state).margin
        self._measured[robot, name] = state, gap, WAIT if gap < NEAR else 0
        return gap > TOUCH

    def _moved(self, robot: str, name: str, before: SceneState, now: SceneState) -> float:
        """Return an upper bound on the distance [m] by which a robot and an object have approached each other."""
        start, end = before.poses[name], now.poses[name]
        turned = 2 * self._rigid[name] * math.sqrt(max(0.0, 1.0 - float(start.q @ end.q) ** 2))
        then, levers = before.robots[robot], self._levers(robot)
        arm = sum(abs(q - then[joint]) * levers[joint] for joint, q in now.robots[robot].items())
        return math.dist(start.p, end.p) + turned + arm


def _levers(bodies: Bodies, robot: str) -> Mapping[str, float]:
    """Return the maximum distance by which a robot's points move per unit of motion of each joint [m per rad or m]."""
    item, balls = bodies[robot].item, [(0.0, 0.0) if form is None else form.ball for form in bodies[robot].forms]
    far = {link.name: float(np.linalg.norm(c)) + r for link, (c, r) in zip(item.links, balls, strict=True)}
    levers = {}
    for joint in reversed(item.joints):  # children follow their parents
        slides = joint.type is JointType.PRISMATIC
        levers[joint.name] = 1.0 if slides else far[joint.child]
        travel = max(map(abs, joint.limits or (math.inf,))) if slides else 0.0
        far[joint.parent] = max(far[joint.parent], float(np.linalg.norm(joint.X_PC.p)) + travel + far[joint.child])
    return levers
