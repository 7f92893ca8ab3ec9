"""Every scene of ``specs/``, and one that says all that a spec can, in every engine that is found.

``python -m tests.corpora.verify`` Robots are there if their models are: see ``docs/robots.md``.

Prints what ``simfoundry verify specs/scenes`` prints, and the figures that are promised: what differs from the scene
without the loss report saying so; slip angle, fall, period and decay of each engine; and how far any two engines are
apart after each scene was left alone for two seconds. Engines that are not in this Python are found by
``SIMFOUNDRY_ENGINES``, as the command does. Exit code 1 if a bar is missed.
"""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from simfoundry.reports.verification import summary
from simfoundry.scene.lower import lower_file
from simfoundry.verify import tables
from simfoundry.verify.behaviors import BEHAVIORS
from simfoundry.verify.engines import VerifyEngine, all_engines, find_installed, interpreters
from simfoundry.verify.run import (
    BehaviorResult,
    ProofStatus,
    ReadbackResult,
    RestResult,
    SceneBuilds,
    built,
    measure_behaviors,
    read_subjects,
    settle_subjects,
)
from tests.specs.documents import SCENES
from tests.targets.everything import write_everything

HARD = ("free_fall", "slip_angle", "period", "decay", "drive", "mimic", "no_contact", "settled_mm", "settled_deg")
"""The behaviors that have a bar; of the others the figure is reported."""

PATIENCE_S = 900.0
"""What a build may take where the machine is busy with other things; only a hang takes longer."""


def main() -> int:
    """Prove all engines that are here; returns the exit code."""
    engines = {engine.name: engine for engine in all_engines()}
    found = find_installed(engines, interpreters([], ()))
    here = [f for f in found.values() if f is not None]
    workers = os.cpu_count() or 1
    with tempfile.TemporaryDirectory(prefix="simfoundry-verify-") as folder:
        present = [f.engine for f in here]
        subjects = _subjects(Path(folder), present)
        everything = built("everything", lower_file(write_everything(_folder(folder))), present, Path(folder) / "all")
        readings = read_subjects([*subjects, everything], here, _tell, workers, PATIENCE_S)
        results = measure_behaviors(BEHAVIORS, here, _tell, workers, PATIENCE_S)
        rested = settle_subjects(subjects, here, _tell, workers, PATIENCE_S)
    for table in (
        tables.readings_table(readings, found),
        tables.behaviors_table(results, BEHAVIORS, found),
        tables.rested_table(rested, found),
        "\n".join(tables.details(readings, results, rested)),
        "\n".join(tables.known_lines(readings, results)),
        "\n".join(tables.stale_lines(readings)),
        "\n".join(tables.absent_line(e) for e in engines.values() if found[e.name] is None),
        summary(readings, results, rested),
    ):
        if table:
            print(table + "\n")
    failures = _failures(readings, results, rested)
    print("\n".join(failures) if failures else f"every bar is met in {', '.join(f.engine.name for f in here)}")
    return 1 if failures else 0


def _folder(folder: str) -> Path:
    found = Path(folder) / "everything"
    found.mkdir()
    return found


def _subjects(folder: Path, engines: Sequence[VerifyEngine]) -> list[SceneBuilds]:
    return [
        built(path.name.removesuffix(".scene.yaml"), lower_file(path), engines, folder / path.stem) for path in SCENES
    ]


def _failures(
    readings: Sequence[ReadbackResult], results: Sequence[BehaviorResult], rested: Sequence[RestResult]
) -> list[str]:
    """A line for every bar that is missed."""
    wrong = [r for r in readings if r.verdict in (ProofStatus.MISMATCH, ProofStatus.FAILED)]
    lines = [f"read-back: {r.subject} in {r.engine}: {tables.reading_cell(r)}" for r in wrong]
    lines += [
        f"behavior: {m.behavior} in {m.engine}: {tables.measured_cell(m)}"
        for m in results
        if m.verdict is ProofStatus.FAILED or (m.verdict is ProofStatus.MISMATCH and m.behavior in HARD)
    ]
    apart = [r for r in rested if r.verdict is not ProofStatus.OK]
    return lines + [f"at rest: {r.subject} in {r.engine}: {tables.rested_cell(r)} {r.worst}" for r in apart]


def _tell(*_: object) -> None:
    print(".", end="", file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())
