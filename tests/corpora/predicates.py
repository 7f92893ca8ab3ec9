"""The same truth in every simulator: random states go into MuJoCo and PyBullet, are read back and judged.

    python -m tests.corpora.predicates [STATES]     STATES of each predicate, 10,000 by default

Prints for each predicate how often it is true and false, in how many states the two simulators and the state itself
disagree, of all and of those with a margin of more than 1 mm (or 0.001 of its unit), and how often the truth changes
when the whole scene is moved and turned, its viewpoint with it. Exits with 1 where a share is above the bar.
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from simfoundry.geometry.frames import Pose, quat_from_rpy, rotate
from simfoundry.predicates import Judge, Poses, StateBatch
from simfoundry.scene.model import Scene
from simfoundry.spec.models.predicate import parse_call
from simfoundry.worlds import World, open_world
from tests.predicates.random_states import CASES, Case, random_batch, scene, states

BAR = 0.001
"""The share of states that may differ."""

CLEAR = 0.001
"""A margin beyond this is clear, in the predicate's unit."""

ENGINES = ("mujoco", "pybullet")
Mask = NDArray[np.bool_]


@dataclass
class Count:
    """What was found for one predicate."""

    states: int = 0
    true: int = 0
    clear: int = 0
    differ: int = 0
    differ_clear: int = 0
    moved: int = 0
    moved_clear: int = 0

    def add(self, values: list[Mask], margin: NDArray[np.float64], moved: Mask) -> None:
        """Count states: ``values`` of the state itself and of each simulator, and of the moved scene."""
        clear = np.abs(margin) > CLEAR
        differ = np.any([v != values[0] for v in values[1:]], axis=0)
        self.states += len(margin)
        self.true += int(values[0].sum())
        self.clear += int(clear.sum())
        self.differ += int(differ.sum())
        self.differ_clear += int((differ & clear).sum())
        self.moved += int((moved != values[0]).sum())
        self.moved_clear += int(((moved != values[0]) & clear).sum())

    @property
    def passed(self) -> bool:
        """Whether the bar is met, and both truths are frequent enough for it to say something."""
        shares = (self.differ_clear / max(self.clear, 1), self.moved_clear / max(self.clear, 1))
        return max(shares) <= BAR and 0.05 < self.true / self.states < 0.95


def read_back(world: World, batch: StateBatch) -> StateBatch:
    """The states as a simulator gives them back."""
    found = []
    for state in states(batch):
        world.reset(state)
        found.append(world.state())
    return StateBatch.of(world.scene, found)


def moved(case: Case, batch: StateBatch, rng: np.random.Generator) -> tuple[Scene, str, StateBatch]:
    """The whole scene elsewhere on the ground and turned, its viewpoint and the numbers of a condition with it."""
    lowered = scene(case.scene)
    X = Pose.of([*rng.uniform(-2, 2, 2), rng.uniform(-0.5, 0.5)], quat_from_rpy(0, 0, rng.uniform(-math.pi, math.pi)))
    viewer = X if lowered.viewer is None else X @ lowered.viewer
    objects = tuple(replace(o, X_WO=X @ o.X_WO) for o in lowered.objects)
    robots = tuple(replace(r, X_WB=X @ r.X_WB) for r in lowered.robots)
    there = {
        name: Poses(X.p + rotate(np.broadcast_to(X.rotation, x.R.shape), x.p), X.rotation @ x.R)
        for name, x in batch.poses.items()
    }
    call = parse_call(case.condition)
    if call.predicate == "At":
        p = X.apply(np.array([float(v) for v in call.args[1:]]))
        call = replace(call, args=(call.args[0], *(f"{v:.12f}" for v in p)))
    return replace(lowered, objects=objects, robots=robots, viewer=viewer), str(call), replace(batch, poses=there)


def counted(case: Case, n: int, seed: int) -> Count:
    """``n`` states of one case."""
    rng, lowered = np.random.default_rng(seed), scene(case.scene)
    judge, batch = Judge(lowered), random_batch(case, n, rng)
    value, margin = judge.batch(case.condition, batch)
    values = [value]
    for engine in ENGINES:
        with open_world(lowered, engine) as world:
            values.append(judge.batch(case.condition, read_back(world, batch))[0])
    count = Count()
    other, condition, there = moved(case, batch, rng)
    count.add(values, margin, Judge(other).batch(condition, there)[0])
    return count


def main(n: int) -> int:
    """Print the table; 1 where the bar is missed."""
    print(
        f"{'predicate':11}{'states':>8}{'true':>7}{'false':>7}{'clear':>7}{'differ':>8}{'clear':>7}{'moved':>7}{'clear':>7}"
    )
    failed = 0
    for name, cases in CASES.items():
        total = Count()
        for k, case in enumerate(cases):
            one = counted(case, math.ceil(n / len(cases)), k)
            for key, value in vars(one).items():
                setattr(total, key, getattr(total, key) + value)
        failed += not total.passed
        row = [total.states, total.true, total.states - total.true, total.clear]
        row += [total.differ, total.differ_clear, total.moved, total.moved_clear]
        text = "".join(f"{v:{w}}" for v, w in zip(row, (8, 7, 7, 7, 8, 7, 7, 7), strict=True))
        print(f"{name:11}{text}{'' if total.passed else '  missed'}", flush=True)
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]) if len(sys.argv) > 1 else 10_000))
