"""The command ``simfoundry compile``, for one or many scenes.

Many scenes are compiled in parallel. The run can be resumed, and all failures are listed at the end.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from simfoundry.cli import output
from simfoundry.cli.options import ANY, NEW_FOLDER, option, set_option
from simfoundry.errors import SimfoundryError

if TYPE_CHECKING:
    from simfoundry.targets.batch import CompileJob, CompileOutcome

TARGETS = ("mjcf", "urdf", "pybullet", "usd")

RECIPE_SUFFIX = ".cousins.yaml"

# Maximum number of characters in the text beside the progress bar; longer texts are cut off at the beginning.
LONGEST_TEXT = 60


@output.subcommand()
@click.argument("scenes", nargs=-1, required=True, type=ANY)
@click.option("-t", "--target", "targets", multiple=True,
              help="Format, simulator, or target folder to compile for; may be repeated. "
                   "Default: all formats.")  # fmt: skip
@option("-o", "--out", type=NEW_FOLDER, default=Path("build"),
        help="Output folder. Contains one folder per target, or one per scene if there are several.")  # fmt: skip
@click.option("-j", "--jobs", type=click.IntRange(1),
              help="Number of scenes to compile in parallel. Default: one per core.")  # fmt: skip
@click.option("--strict", is_flag=True, help="Exit with code 1 if a target cannot represent everything.")
@click.option("--force", is_flag=True,
              help="Recompile scenes that are up to date, and replace folders that contain other files.")  # fmt: skip
@set_option
def compile_command(
    scenes: tuple[Path, ...], targets: tuple[str, ...], out: Path, jobs: int | None, strict: bool, force: bool,
    parameters: dict[str, float], as_json: bool,
) -> int:  # fmt: skip
    """Compile scenes for simulators, and report everything that a target cannot represent.

    From a recipe, its twin is compiled, with the random values of `vary` as event terms if the target has them.

    A single scene is written to OUT/TARGET. Multiple scenes, or all scenes below a folder, are written to
    OUT/SCENE/TARGET. They are compiled in parallel in separate processes, and scenes that are up to date are skipped.

    If a target or a scene fails, the failure is reported, the others are still compiled, and the exit code is 1. If no
    target of a single scene can be compiled, the exit code is 2.
    """
    targets = targets or TARGETS
    if len(scenes) > 1 or scenes[0].is_dir():
        if parameters:
            raise SimfoundryError("--set applies to a single scene; compile the scenes one by one")
        return _compile_many(scenes, targets, out, jobs, strict, force, as_json)
    return _compile_one(scenes[0], targets, out, strict, force, parameters, as_json)


def _compile_one(
    scene: Path, targets: tuple[str, ...], out: Path, strict: bool, force: bool, parameters: Mapping[str, float],
    as_json: bool,
) -> int:  # fmt: skip
    from simfoundry.assets.cache import Cache
    from simfoundry.scene.lower import lower_file
    from simfoundry.targets.build import LOSSES, TargetsError, build, report, table

    with output.progress_bar(as_json) as progress:

        def seen(name: str, done: int, total: int) -> None:
            progress(name, done / total)

        if scene.name.endswith(RECIPE_SUFFIX):
            from simfoundry.cousins.randomization.recipe_scene import recipe_scene

            lowered = recipe_scene(scene, Cache.default(), seen, parameters)
        else:
            lowered = lower_file(scene, Cache.default(), seen, parameters=parameters)
        failures: Mapping[str, str] = {}
        try:
            artifacts = build(lowered, targets, out, force)
        except TargetsError as error:
            artifacts, failures = error.artifacts, error.failures
    errors = [f"{target} is not written: {reason}" for target, reason in failures.items()]
    if not artifacts:
        raise SimfoundryError("\n".join(errors))
    losses = report(lowered, artifacts)
    lossy = any(artifact.losses for artifact in artifacts)
    entries = {a.target: str(out / a.target / a.entry) for a in artifacts}
    if as_json:
        failed = {"failed": failures} if failures else {}
        output.print_json({"out": str(out), "targets": entries, "losses": losses, **failed})
    else:
        width = max(map(len, entries))
        for target, entry in entries.items():
            click.echo(f"{target:<{width}}  {entry}")
            for line in _dropped(losses[target]["losses"]):
                click.echo(f"{'':<{width}}  {line}")
        click.echo("\n" + "\n".join(table(losses)))
        if lossy:
            click.echo(f"reasons and amounts: {out / LOSSES}")
        for line in errors:
            click.echo(f"Error: {line}", err=True)
    return output.FINDINGS if failures or (strict and lossy) else output.DONE


def _dropped(losses: Sequence[Mapping[str, str]]) -> list[str]:
    """Return one line for each reason why elements were dropped.

    Example: ``gravity is not written: URDF has no world settings``.
    """
    by_reason: dict[str, list[str]] = {}
    for loss in losses:
        if loss["fidelity"] == "dropped":
            by_reason.setdefault(loss["reason"], []).append(loss["path"])
    lines = []
    for reason, paths in by_reason.items():
        more = f" and {len(paths) - 3} more" if len(paths) > 3 else ""
        verb = "are" if len(paths) > 1 else "is"
        lines.append(f"{', '.join(paths[:3])}{more} {verb} not written: {reason}")
    return lines


def _compile_many(
    paths: Sequence[Path], targets: tuple[str, ...], out: Path, workers: int | None, strict: bool, force: bool,
    as_json: bool,
) -> int:  # fmt: skip
    """Compile all scenes in ``paths`` and below the folders in ``paths``, and return the exit code."""
    from simfoundry.targets.batch import COMPILED, CURRENT, FAILED, compile_all, compile_job, jobs_of
    from simfoundry.targets.find import find_targets

    find_targets(targets)  # report a misspelled target once, not once per scene
    jobs = list({job.scene.resolve(): job for job in jobs_of(paths, targets, out, force)}.values())
    _ensure_apart(jobs, paths)
    with output.progress_bar(as_json) as progress:
        if len(jobs) == 1:
            outcomes = [compile_job(jobs[0])]
        else:
            cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1

            def report(activity: str, done: int) -> None:
                text = activity if len(activity) <= LONGEST_TEXT else f"…{activity[1 - LONGEST_TEXT :]}"
                progress(text, done / len(jobs))

            outcomes = compile_all(jobs, workers or cores, report)
    found = Counter(outcome.state for outcome in outcomes)
    if as_json:
        counts = {state.replace(" ", "_"): found[state] for state in (COMPILED, CURRENT, FAILED)}
        output.print_json({"out": str(out), **counts, "scenes": [outcome.to_json() for outcome in outcomes]})
    else:
        _print(outcomes, found)
    lossy = any(any(outcome.losses.values()) for outcome in outcomes)
    return output.FINDINGS if found[FAILED] or (strict and lossy) else output.DONE


def _ensure_apart(jobs: Sequence[CompileJob], paths: Sequence[Path]) -> None:
    """Check that there are scenes and that no two of them would share an output folder.

    Raises:
        SimfoundryError: If there are no scenes, or if two scenes would share an output folder.
    """
    if not jobs:
        raise SimfoundryError(f"could not find any *.scene.yaml file below {', '.join(map(str, paths))}")
    taken: dict[Path, Path] = {}
    for job in jobs:
        other = taken.setdefault(job.out, job.scene)
        if other != job.scene:
            both = f"{other} and {job.scene}"
            raise SimfoundryError(f"{both} would both be written to {job.out}; pass a folder that contains both")


def _print(outcomes: Sequence[CompileOutcome], found: Counter[str]) -> None:
    """Print one line for each scene, then the errors of the scenes that failed, then the totals."""
    from simfoundry.targets.batch import COMPILED, CURRENT, FAILED

    width = max(len(outcome.scene) for outcome in outcomes)
    for outcome in outcomes:
        lost = ", ".join(f"{count} in {target}" for target, count in outcome.losses.items() if count)
        more = "" if outcome.state == FAILED else f"  {outcome.out}" + (f"  (lost: {lost})" if lost else "")
        click.echo(f"{outcome.scene:<{width}}  {outcome.state:<{len(CURRENT)}}{more}".rstrip())
    for outcome in outcomes:
        output.print_findings(list(outcome.findings))
        if outcome.error:
            click.echo(f"{outcome.scene}: {outcome.error}", err=True)
    click.echo(", ".join(f"{found[state]} {state}" for state in (COMPILED, CURRENT, FAILED) if found[state]))
