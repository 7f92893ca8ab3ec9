"""Train on ten demonstrations, and on 200 made of them: ``python -m tests.corpora.augmented_data_pays [FOLDER]``.

Baselines learn a task (``--task``, Cup in Bowl by default) from ten demonstrations of the expert, and from 200 that
were generated from these ten, each with three training seeds and the same number of steps. All are evaluated from the
same 25 initial states, which neither has seen. Exits with 1 unless the generated demonstrations give at least twice as
many wins. Every stage is resumed if the command is repeated. It needs the model of the DROID arm, and the extra
`train`.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from simfoundry.api.training import Trained, TrainingRun, run_training
from simfoundry.evaluate.statistics.metrics import Rate
from simfoundry.train.fit import FitOptions
from tests.corpora.augmentation import REPOSITORY, SPECS, shown

# Demonstrations of the expert, generated ones, training seeds, and rollouts of each policy.
SOURCES, GENERATED, SEEDS, ROLLOUTS = 10, 200, (0, 1, 2), 25

# Factor by which the generated demonstrations must increase the wins.
BAR = 2.0


def trained(task: str, folder: Path, augment: int | None, steps: int, jobs: int) -> Trained:
    """Train and evaluate the three policies. Both conditions share the demonstrations in the folder."""
    run = TrainingRun(
        sources=(SPECS / "tasks" / f"{task}.task.yaml",),
        folder=folder,
        options=FitOptions(steps=steps),
        seeds=SEEDS,
        count=SOURCES,
        augment=augment,
        rollouts=ROLLOUTS,
        jobs=jobs,
        video=False,
    )
    return run_training(run, shown("recorded" if augment is None else "augmented"))


def main() -> int:
    """Carry out the experiment, and print its table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path, default=REPOSITORY / "build" / "augmented_data_pays")
    parser.add_argument("--task", default="cup_in_bowl", help="name of a task of specs/tasks")
    parser.add_argument("--steps", type=int, default=6000)
    parser.add_argument("-j", "--jobs", type=int, default=2)
    given = parser.parse_args()
    totals, rows = {}, {}
    print(f"{'learned from':<28} {'each seed':<16} success", flush=True)
    for name, augment in ((f"{SOURCES} recorded", None), (f"{GENERATED} generated from {SOURCES}", GENERATED)):
        rates = list(trained(given.task, given.folder, augment, given.steps, given.jobs).rates.values())
        totals[name] = Rate(sum(rate.done for rate in rates), sum(rate.of for rate in rates))
        rows[name] = [[rate.done, rate.of] for rate in rates]
        print(f"{name:<28} {', '.join(str(rate.done) for rate in rates):<16} {totals[name]}", flush=True)
    (given.folder / "augmented_data_pays.json").write_text(json.dumps(rows, indent=1) + "\n")
    before, after = totals.values()
    print(f"{after.done / max(before.done, 1):.1f} times as many wins (bar: {BAR:g})")
    return int(after.done < BAR * before.done or not after.done)


if __name__ == "__main__":
    sys.exit(main())
