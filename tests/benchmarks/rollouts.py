"""What a rollout costs: ``python -m tests.benchmarks.rollouts [TASK]``.

Prints what `World.step` adds to a bare `mj_step` (measured in turns, on the same model), and where the time of a
closed-loop rollout of 10 s goes: two cameras of 320 x 240 pixels, eight actions an answer. Needs the robot's model for
the tasks of ``specs/``; without an argument it takes the first of them whose robot is there, else a bench of the tests.
"""

from __future__ import annotations

import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from simfoundry.evaluate.policies.base import ImageSize, Observation
from simfoundry.evaluate.resets.starts import starts
from simfoundry.evaluate.rollouts.rollout import Rollout, rollout
from simfoundry.evaluate.task import Task, load_task
from simfoundry.geometry.frames import Array
from simfoundry.predicates import Judge
from simfoundry.spec.models.predicate import AllOf, NoneOf
from simfoundry.spec.models.signals import ActionSpace, ImageKind
from simfoundry.worlds.mujoco_world import MujocoWorld
from tests.evaluate.benches import write_bench

# tests.conftest would hide the robots' models.
REPOSITORY = Path(__file__).resolve().parents[2]

SECONDS, HORIZON = 10, 8
SIZE = ImageSize(320, 240)


@dataclass
class Wandering:
    """Small random steps from where each arm is, as a policy that looks would take them."""

    size: int
    cameras: Mapping[str, ImageSize] = field(default_factory=dict)
    name: str = "wandering"
    action_space: ActionSpace = ActionSpace.JOINT_POSITION
    control_hz: float | None = None
    image_kinds: tuple[ImageKind, ...] = (ImageKind.COLOR,)
    origin: Mapping[str, Any] = field(default_factory=dict)
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))

    def reset(self, instruction: str, seed: int) -> None:
        self.rng = np.random.default_rng(seed)

    def infer(self, observation: Observation) -> Array:
        now = np.concatenate([[*r.joints, 0.0] for r in observation.robots.values()])
        return now + np.cumsum(self.rng.normal(0.0, 0.01, (HORIZON, self.size)), axis=0)

    def close(self) -> None:
        pass


def main() -> int:
    """Print the figures."""
    with tempfile.TemporaryDirectory() as temporary:
        task = _task(Path(sys.argv[1]) if len(sys.argv) > 1 else None, Path(temporary))
        names = [c.name for c in task.scene.cameras][:1] + [m.camera.name for m in task.scene.mounted]
        cameras = dict.fromkeys((names + [c.name for c in task.scene.cameras])[:2], SIZE)
        with MujocoWorld(task.scene) as world:
            print(f"{task.name}: {world.model.nv} degrees of freedom, {world.model.ngeom} geoms")
            for each in (1, 33):
                print(f"World.step({each}) over mj_step: {_overhead(world, each):+.2%}")
            _rollouts(task, world, cameras)
    return 0


def _task(path: Path | None, folder: Path) -> Task:
    if path is not None:
        return load_task(path)
    for file in sorted((REPOSITORY / "specs" / "tasks").glob("*.task.yaml")):
        task = load_task(file)
        if not task.missing_robots:
            return task
    return load_task(write_bench(folder))


def _overhead(world: MujocoWorld, each: int, rounds: int = 60, steps: int = 330) -> float:
    """The median over rounds of how much longer our steps take than bare ones from the same state, less one."""
    import mujoco

    model, data = world.model, world.data

    def bare() -> None:
        for _ in range(steps // each):
            mujoco.mj_step(model, data, nstep=each)

    def ours() -> None:
        for _ in range(steps // each):
            world.step(each)

    ratios = []
    for k in range(rounds):
        pair: list[Callable[[], None]] = [bare, ours] if k % 2 else [ours, bare]
        spent = {}
        for run in pair:
            world.reset()
            begun = time.process_time()
            run()
            spent[run.__name__] = time.process_time() - begun
        ratios.append(spent["ours"] / spent["bare"])
    return statistics.median(ratios) - 1


def _rollouts(task: Task, world: MujocoWorld, cameras: Mapping[str, ImageSize]) -> None:
    """Where the time goes of rollouts of 10 s that see, and of ones that do not, beside the physics alone."""
    steps = round(SECONDS * task.control_hz)
    task = replace(task, horizon=steps, goal=AllOf(all=(task.goal, NoneOf(**{"not": task.goal}))))  # never done
    start = starts(task, 1)[0]
    judge = Judge(task.scene)
    size = sum(len(world.robot(name).joints) + 1 for name in task.robots)
    rollout(replace(task, horizon=1), start, Wandering(size, cameras), world, judge)  # opens the GL driver
    print(f"{'10 s with':<24}{'wall':>8}{'processor':>11}{'physics':>9}{'render':>8}{'judge':>8}{'policy':>8}  [s]")
    for label, eyes in (("no camera", {}), (f"{len(cameras)} cameras", cameras)):
        results = []
        for _ in range(3):
            begun = time.process_time()
            result = rollout(task, start, Wandering(size, eyes), world, judge)
            results.append((result.timings.total, time.process_time() - begun, result))
        wall, processor, best = min(results, key=lambda r: r[0])
        _row(f"{label}, {best.chunks} looks", wall, processor, best)
    world.reset(start.state)
    begun = time.perf_counter()
    world.step(round(SECONDS / world.timestep))
    print(f"{'bare physics, at rest':<24}{time.perf_counter() - begun:>8.2f}")


def _row(label: str, wall: float, processor: float, done: Rollout) -> None:
    t = done.timings
    print(f"{label:<24}{wall:>8.2f}{processor:>11.2f}{t.physics:>9.2f}{t.render:>8.2f}{t.judge:>8.2f}{t.policy:>8.2f}")


if __name__ == "__main__":
    sys.exit(main())
