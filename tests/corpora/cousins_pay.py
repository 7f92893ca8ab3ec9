"""Train on cousins and on the twin alone: ``python -m tests.corpora.cousins_pay [FOLDER]``.

Two baselines learn Cup in Bowl from the same number of demonstrations, one from the twin, the other from cousins whose
layouts, objects, masses and frictions vary, each with three training seeds. All are evaluated on the same held-out
cousins: scenes with other layouts, and scenes with other cups and bowls. Every stage is resumed if the command is
repeated; FOLDER must be inside the repository. It needs the model of the DROID arm, and the extra `train`.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from simfoundry import load_task
from simfoundry.api.cousins import make_cousins
from simfoundry.api.training import TrainingRun, run_training
from simfoundry.evaluate.statistics.metrics import Rate, sign_flip
from simfoundry.runtime.executors import LOCAL
from simfoundry.train.fit import FitOptions

# Not that of tests.conftest, which hides the robots' models from tests.
REPOSITORY = Path(__file__).resolve().parents[2]
SPECS = REPOSITORY / "specs"
TWIN = SPECS / "tasks" / "cup_in_bowl.task.yaml"

# Demonstrations of each policy, steps of each training, and its seeds: an hour and a quarter on two cores.
DEMONSTRATIONS, STEPS, SEEDS = 150, 5000, (0, 1, 2)

# Held-out cousins by what differs from the twin: the recipe, a seed that no recipe has, and their number.
HELD_OUT = {
    "scenes": ("cup_in_bowl_randomized", 9001, 12),
    "objects": ("other_cups", 9002, 12),
}


def main(folder: Path, jobs: int = 2) -> int:
    """Carry out the experiment, and print its table."""
    begun = time.monotonic()
    cousins = made("cup_in_bowl_everywhere", None, DEMONSTRATIONS, folder / "everywhere", jobs)
    held_out = {kind: made(name, seed, n, folder / kind, jobs) for kind, (name, seed, n) in HELD_OUT.items()}
    tasks = tuple(task for found in held_out.values() for task in found)
    records = {}
    for source, sources in (("twin", [TWIN]), ("cousins", cousins)):
        run = TrainingRun(
            sources=tuple(sources),
            folder=folder / source,
            options=FitOptions(steps=STEPS),
            seeds=SEEDS,
            count=DEMONSTRATIONS,
            tasks=tasks,
            rollouts=1,
            jobs=jobs,
            video=False,
        )
        records[source] = run_training(run, shown()).evaluation.records
    rows = list(table(records, held_out))
    print(f"\n{'held out':<10}{'trained on':<12}{'each seed':<16}success")
    for row in rows:
        print(f"{row['held_out']:<10}{row['trained_on']:<12}{', '.join(map(str, row['seeds'])):<16}{row['rate']}")
    for kind, found in held_out.items():
        p = p_value(records, kind, held_out)
        print(f"{kind}: p = {p:.2g}, paired permutation test over {len(found)} cousins")
    print(f"{(time.monotonic() - begun) / 60:.0f} minutes")
    (folder / "cousins_pay.json").write_text(json.dumps(rows, indent=1, default=str) + "\n")
    best = {(row["held_out"], row["trained_on"]): row["rate"].share for row in rows}
    return int(any(best[kind, "cousins"] <= best[kind, "twin"] for kind in held_out))


def made(recipe: str, seed: int | None, count: int, out: Path, jobs: int) -> list[Path]:
    """Make the cousins of a recipe, or those that are missing."""
    return make_cousins(SPECS / "cousins" / f"{recipe}.cousins.yaml", out, count, jobs, LOCAL, shown(), seed)


def table(records: Mapping[str, Sequence[Mapping[str, Any]]], held_out: Mapping[str, list[Path]]) -> Any:
    """The success rates by kind of cousin and source of the demonstrations, over all seeds."""
    for kind in held_out:
        for source in records:
            each = [
                Rate(sum(outcomes), len(outcomes)) for outcomes in by_seed(records[source], kind, held_out).values()
            ]
            rate = Rate(sum(one.done for one in each), sum(one.of for one in each))
            yield {"held_out": kind, "trained_on": source, "seeds": [one.done for one in each], "rate": rate}


def by_seed(
    records: Sequence[Mapping[str, Any]], kind: str, held_out: Mapping[str, list[Path]]
) -> dict[str, list[bool]]:
    """The outcomes of each policy on one kind of cousins, in the order of the cousins."""
    names = names_of(held_out[kind])
    found: dict[str, dict[str, bool]] = {}
    for record in records:
        if record["task"] in names:
            found.setdefault(record["policy"], {})[record["task"]] = bool(record["success"])
    return {policy: [outcomes[name] for name in names] for policy, outcomes in found.items()}


def names_of(tasks: Sequence[Path]) -> list[str]:
    """The names of tasks, as in records."""
    return [load_task(task).name for task in tasks]


def p_value(records: Mapping[str, Sequence[Mapping[str, Any]]], kind: str, held_out: Mapping[str, list[Path]]) -> float:
    """The p-value of the difference between the two sources, with one difference of mean success for each cousin."""
    means = [np.mean(list(by_seed(records[source], kind, held_out).values()), axis=0) for source in ("cousins", "twin")]
    return sign_flip((means[0] - means[1]).tolist())


def shown() -> Any:
    """A callback that prints what is being done, every 20 s."""
    last = [0.0]

    def report(text: str, share: float) -> None:
        if time.monotonic() - last[0] > 20:
            last[0] = time.monotonic()
            print(f"{text} ({share:.0%})", flush=True)

    return report


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]) if len(sys.argv) > 1 else REPOSITORY / "build" / "cousins_pay"))
