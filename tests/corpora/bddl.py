"""``python -m tests.corpora.bddl``: each BDDL file of ../shared/data/scenes becomes a task, or says what is missing.

Each is bound to a scene of boxes that has a thing of each of its names, so that what is missing is a word that the
language lacks, and not a thing.
"""

from __future__ import annotations

import sys
import tempfile
from collections import Counter
from pathlib import Path

from simfoundry.frontends.bddl.problem import read_problem
from simfoundry.frontends.draft import ImportOptions
from simfoundry.frontends.errors import ImportRefusedError
from simfoundry.frontends.importer import import_file
from simfoundry.spec.load import load
from simfoundry.spec.models.task import TaskSpec
from tests.conftest import REPOSITORY
from tests.frontends.bddl.scenes import write_scene

EXPECTED = {"bddl_libero": 25, "bddl_behavior": 9}


def main() -> int:
    """Print a line for each file; 1 where one breaks, or where files are missing."""
    counts: Counter[str] = Counter()
    bad = 0
    for folder, expected in EXPECTED.items():
        files = sorted((REPOSITORY.parent / "shared/data/scenes" / folder).glob("*.bddl"))
        if len(files) != expected:
            print(f"{folder}: {expected} files are expected, {len(files)} are here")
            bad += 1
        for file in files:
            with tempfile.TemporaryDirectory() as place:
                outcome, line = attempt(file, Path(place))
            counts[outcome] += 1
            bad += outcome == "BROKEN"
            print(f"{outcome:<8} {folder[5:]:<9}{file.stem[:58]:<60}{line}")
    print(", ".join(f"{count} {outcome}" for outcome, count in sorted(counts.items())))
    return 1 if bad else 0


def attempt(file: Path, place: Path) -> tuple[str, str]:
    """What becomes of one file: ``task``, ``missing`` or ``BROKEN``, and its goal or the reason."""
    scene = write_scene(read_problem(file), place)
    out = place / "x.task.yaml"
    try:
        report = import_file(file, out, ImportOptions(scene=scene))
    except ImportRefusedError as error:
        found = error.reason.partition(": ")[2]
        return ("missing" if "line " in error.reason else "BROKEN"), found
    except Exception as error:
        return "BROKEN", f"{type(error).__name__}: {error}"
    loaded = load(out)
    if loaded.errors or not isinstance(loaded.spec, TaskSpec):
        return "BROKEN", str(loaded.errors[:1])
    goal = loaded.spec.goal
    shown = goal if isinstance(goal, str) else goal.model_dump_json(by_alias=True)
    return "task", f"{shown[:150]}{'…' if len(shown) > 150 else ''}  ({len(report.notes)} notes)"


if __name__ == "__main__":
    sys.exit(main())
