"""Generate demonstrations from ten: ``python -m tests.corpora.augmentation [FOLDER] [-n 200] [-j 2] [CASE ...]``.

The expert demonstrates each task ten times. From these, N demonstrations are generated from initial states that were
not recorded, and in ten scene cousins. Prints the success rate of the attempts with its 95% interval, the highest and
the lowest rate of a demonstration, and why attempts failed. Exits with 1 if a rate is below its bar. Every stage is
resumed if the command is repeated; FOLDER must be inside the repository. It needs the model of the DROID arm.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from simfoundry.api.augmentation import augment_plan
from simfoundry.api.cousins import make_cousins
from simfoundry.api.demonstrations import record_plan, run_record
from simfoundry.augment.report import AugmentReport, augment_report
from simfoundry.runtime.executors import LOCAL

# Not that of tests.conftest, which hides the robots' models from tests.
REPOSITORY = Path(__file__).resolve().parents[2]
SPECS = REPOSITORY / "specs"

# Number of demonstrations of the expert, and number of cousins.
SOURCES, COUSINS = 10, 10


@dataclass(frozen=True)
class Case:
    """A task to augment: its name, the recipe of its cousins or an empty string, and the rate that is required."""

    task: str
    recipe: str = ""
    bar: float = 0.0


CASES = {
    "cup_in_bowl": Case("cup_in_bowl", bar=0.6),
    "cup_in_bowl_cousins": Case("cup_in_bowl", "cup_in_bowl", bar=0.6),
    "other_cups": Case("cup_in_bowl", "other_cups"),
    "stack_dishware": Case("stack_dishware", bar=0.4),
    "store_marker": Case("store_marker", bar=0.4),
}


def generated(name: str, folder: Path, count: int, jobs: int) -> AugmentReport:
    """Carry out a case, or what is missing of it, and return its rates."""
    case = CASES[name]
    demos = folder / "demos" / case.task
    document = SPECS / "tasks" / f"{case.task}.task.yaml"
    run_record(record_plan([document], "expert", demos, SOURCES), jobs, LOCAL, shown(f"{case.task}: expert"))
    tasks: list[Path] = []
    if case.recipe:
        recipe = SPECS / "cousins" / f"{case.recipe}.cousins.yaml"
        tasks = make_cousins(recipe, folder / "cousins" / name, COUSINS, jobs, LOCAL, shown(f"{name}: cousins"))
    plan = augment_plan(demos, tasks, folder / "augmented" / f"{name}_{count}", count, options={"use": SOURCES})
    run_record(plan, jobs, LOCAL, shown(name))
    return augment_report(plan.folder)


def shown(name: str) -> Callable[[str, float], None]:
    """Return a callback that prints progress every ten seconds."""
    last = 0.0

    def show(text: str, _: float) -> None:
        nonlocal last
        if time.monotonic() - last > 10:
            last = time.monotonic()
            print(f"{name}: {text}", file=sys.stderr, flush=True)

    return show


def main() -> int:
    """Carry out the cases, and print their table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path, default=REPOSITORY / "build" / "augmentation")
    parser.add_argument("cases", nargs="*", metavar="CASE", help=", ".join(CASES))
    parser.add_argument("-n", "--count", type=int, default=200)
    parser.add_argument("-j", "--jobs", type=int, default=2)
    given = parser.parse_intermixed_args()
    print(f"{'case':<20} {'success of attempts':<24} {'bar':>4}  best and worst demonstration; failures", flush=True)
    missed, rows = 0, {}
    for name in given.cases or CASES:
        report = generated(name, given.folder, given.count, given.jobs)
        rows[name], bar = report.to_json(), CASES[name].bar
        ranked = sorted(report.sources.values(), key=lambda rate: rate.share)
        sources = f"{ranked[-1].share:.0%} and {ranked[0].share:.0%}" if ranked else ""
        failures = "; ".join(f"{count} {kind}" for kind, count in report.failures.items())
        print(f"{name:<20} {report.total!s:<24} {bar or '':>4}  {sources}; {failures or 'none'}", flush=True)
        missed += report.total.share < bar
    (given.folder / "augmentation.json").write_text(json.dumps(rows, indent=1) + "\n")
    return int(missed > 0)


if __name__ == "__main__":
    sys.exit(main())
