"""``simfoundry compile`` for many scenes: parallel and resumable, with every failure listed at the end."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from simfoundry.cli.output import DONE, FINDINGS, CannotError, print_findings, print_json, progress_bar

if TYPE_CHECKING:
    from simfoundry.targets.batch import CompileJob, CompileOutcome


def compile_many(
    paths: Sequence[Path], targets: tuple[str, ...], out: Path, workers: int | None, strict: bool, force: bool,
    as_json: bool,
) -> int:  # fmt: skip
    """Compile the scenes among ``paths`` and below its folders; return the exit code."""
    from simfoundry.targets.batch import COMPILED, CURRENT, FAILED, jobs_of
    from simfoundry.targets.find import find_target

    for name in targets:
        find_target(name)  # report a misspelled target once, not once per scene
    jobs = list({job.scene.resolve(): job for job in jobs_of(paths, targets, out, force)}.values())
    _ensure_apart(jobs, paths)
    with progress_bar(as_json) as progress:
        outcomes = _outcomes(jobs, workers or _cores(), lambda said, done: progress(_short(said), done / len(jobs)))
    found = Counter(outcome.state for outcome in outcomes)
    counts = {state.replace(" ", "_"): found[state] for state in (COMPILED, CURRENT, FAILED)}
    if as_json:
        print_json({"out": str(out), **counts, "scenes": [outcome.to_json() for outcome in outcomes]})
    else:
        _print(outcomes, found)
    lossy = any(any(outcome.losses.values()) for outcome in outcomes)
    return FINDINGS if found[FAILED] or (strict and lossy) else DONE


def _outcomes(jobs: Sequence[CompileJob], workers: int, report: Callable[[str, int], object]) -> list[CompileOutcome]:
    """Yield the outcome of each job; compile a single scene in this process."""
    from simfoundry.targets.batch import compile_all, compile_job

    return [compile_job(jobs[0])] if len(jobs) == 1 else compile_all(jobs, workers, report)


def _ensure_apart(jobs: Sequence[CompileJob], paths: Sequence[Path]) -> None:
    """Raise :class:`CannotError` if there is no scene, or if two scenes would share a folder."""
    if not jobs:
        raise CannotError(f"there is no *.scene.yaml below {', '.join(map(str, paths))}")
    taken: dict[Path, Path] = {}
    for job in jobs:
        other = taken.setdefault(job.out, job.scene)
        if other != job.scene:
            raise CannotError(
                f"{other} and {job.scene} would both be written to {job.out}; pass a folder that contains both"
            )


def _print(outcomes: Sequence[CompileOutcome], found: Counter[str]) -> None:
    """Print a line for each scene, then the errors of those that failed, then the totals."""
    from simfoundry.targets.batch import COMPILED, CURRENT, FAILED

    width = max(len(outcome.scene) for outcome in outcomes)
    for outcome in outcomes:
        lost = ", ".join(f"{count} in {target}" for target, count in outcome.losses.items() if count)
        more = "" if outcome.state == FAILED else f"  {outcome.out}" + (f"  (lost: {lost})" if lost else "")
        click.echo(f"{outcome.scene:<{width}}  {outcome.state:<{len(CURRENT)}}{more}".rstrip())
    for outcome in outcomes:
        print_findings(list(outcome.findings))
        if outcome.error:
            click.echo(f"{outcome.scene}: {outcome.error}", err=True)
    click.echo(", ".join(f"{found[state]} {state}" for state in (COMPILED, CURRENT, FAILED) if found[state]))


def _short(text: str, most: int = 60) -> str:
    return text if len(text) <= most else f"…{text[-most + 1 :]}"


def _cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
