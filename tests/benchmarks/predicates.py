"""How many states a second each predicate is judged in, vectorized, on one core: prints a table.

    python -m tests.benchmarks.predicates [STATES]

The states are those of the proof: things so near each other that the predicate is often true and often false, so that
bounds seldom decide. `apart` is the same with the things where rollouts mostly have them: within half a meter.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np

from simfoundry.predicates import Judge, StateBatch
from tests.predicates.random_states import CASES, Case, random_batch, scene

ROOM = 0.5
"""How far apart [m] things are at most, along each axis, in the states of a rollout."""


def _one_core() -> None:
    """Start again with linear algebra on one core, which must be said before it is loaded."""
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    if any(os.environ.get(name) != value for name, value in threads.items()):
        command = [sys.executable, "-m", "tests.benchmarks.predicates", *sys.argv[1:]]
        sys.exit(subprocess.run(command, env=os.environ | threads).returncode)


def rate(judge: Judge, condition: str, batch: StateBatch) -> tuple[float, float]:
    """States a second, the best of three runs, and the share in which the condition holds."""
    judge.batch(condition, batch)  # what is prepared once
    best = np.inf
    for _ in range(3):
        start = time.perf_counter()
        values, _ = judge.batch(condition, batch)
        best = min(best, time.perf_counter() - start)
    return batch.n / best, float(values.mean())


def _roomy(case: Case) -> Case:
    if case.b == "arm":
        return replace(case, x=(-ROOM, ROOM), y=(-ROOM, ROOM), z=(-ROOM / 2, ROOM))
    return replace(case, x=(-ROOM, ROOM), y=(-ROOM, ROOM), z=(min(case.z), max(case.z) + 0.1))


def main(n: int) -> None:
    """Print the table."""
    every = dict.fromkeys(("near", "apart"), 0.0)
    count = 0
    print(f"{'condition':36}{'near [1/s]':>12}{'true':>7}{'apart [1/s]':>13}{'true':>7}   ({n} states)")
    for cases in CASES.values():
        for case in cases:
            judge, rng = Judge(scene(case.scene)), np.random.default_rng(0)
            near = rate(judge, case.condition, random_batch(case, n, rng))
            apart = rate(judge, case.condition, random_batch(_roomy(case), n, rng))
            every["near"] += 1 / near[0]
            every["apart"] += 1 / apart[0]
            count += 1
            print(f"{case.condition:36}{near[0]:12,.0f}{near[1]:7.1%}{apart[0]:13,.0f}{apart[1]:7.1%}", flush=True)
    print(f"{'all of them, one after another':36}{count / every['near']:12,.0f}{'':7}{count / every['apart']:13,.0f}")


if __name__ == "__main__":
    _one_core()
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 8192)
