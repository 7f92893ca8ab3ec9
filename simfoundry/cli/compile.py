"""``simfoundry compile``."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import click

from simfoundry.cli.options import ANY, NEW_FOLDER
from simfoundry.cli.output import DONE, FINDINGS, CannotError, print_json, progress_bar, subcommand

# NumPy starts a BLAS thread pool at import, a tenth of the command's run time, and no matrix here is large.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

TARGETS = ("mjcf", "urdf", "pybullet", "usd")


@subcommand()
@click.argument("scenes", nargs=-1, required=True, type=ANY)
@click.option(
    "-t", "--target", "targets", multiple=True,
    help="Compile for a format, a simulator, or a target folder of your own. Default: all formats.",
)  # fmt: skip
@click.option(
    "-o", "--out", type=NEW_FOLDER, default=Path("build"), show_default=True,
    help="Write one folder per target here; with several scenes, one folder per scene.",
)  # fmt: skip
@click.option(
    "-j", "--jobs", type=click.IntRange(1), help="Compile this many scenes in parallel. Default: one per core."
)
@click.option("--strict", is_flag=True, help="Exit with code 1 if a target cannot represent everything.")
@click.option(
    "--force", is_flag=True, help="Recompile scenes that are up to date, and replace folders that contain other files."
)
def command(
    scenes: tuple[Path, ...],
    targets: tuple[str, ...],
    out: Path,
    jobs: int | None,
    strict: bool,
    force: bool,
    as_json: bool,
) -> int:
    """Compile scenes for simulators, one folder per target, with a report of everything that was lost.

    A target that fails is reported and the others are written; the exit code is then 1, or 2 if none is written.

    One scene goes to OUT/TARGET. Several scenes, or the scenes below folders, go to OUT/SCENE/TARGET; they compile in
    parallel, each in its own process. Scenes that are up to date are skipped. If one fails, the others continue, and
    the exit code is 1.
    """
    if len(scenes) > 1 or scenes[0].is_dir():
        from simfoundry.cli.compile_many import compile_many

        return compile_many(scenes, targets or TARGETS, out, jobs, strict, force, as_json)
    return _compile_one(scenes[0], targets or TARGETS, out, strict, force, as_json)


def _compile_one(scene: Path, targets: tuple[str, ...], out: Path, strict: bool, force: bool, as_json: bool) -> int:
    from simfoundry.assets.cache import Cache
    from simfoundry.scene.lower import lower_file
    from simfoundry.targets.build import LOSSES, TargetsError, build
    from simfoundry.targets.report import report, table

    with progress_bar(as_json) as progress:
        lowered = lower_file(scene, Cache.default(), lambda name, done, total: progress(name, done / total))
        failures: Mapping[str, str] = {}
        try:
            artifacts = build(lowered, targets, out, force)
        except TargetsError as error:
            artifacts, failures = error.artifacts, error.failures
    if not artifacts:
        raise CannotError("\n".join(_failed(failures)))
    losses = report(lowered, artifacts)
    lossy = any(artifact.losses for artifact in artifacts)
    if as_json:
        entries = {a.target: str(out / a.target / a.entry) for a in artifacts}
        failed = {"failed": failures} if failures else {}
        print_json({"out": str(out), "targets": entries, "losses": losses, **failed})
        return FINDINGS if failures or (strict and lossy) else DONE
    width = max(len(artifact.target) for artifact in artifacts)
    for artifact in artifacts:
        click.echo(f"{artifact.target:<{width}}  {out / artifact.target / artifact.entry}")
        for line in dropped(losses[artifact.target]["losses"]):
            click.echo(f"{'':<{width}}  {line}")
    click.echo()
    for line in table(losses):
        click.echo(line)
    if lossy:
        click.echo(f"reasons and amounts: {out / LOSSES}")
    for line in _failed(failures):
        click.echo(f"Error: {line}", err=True)
    return FINDINGS if failures or (strict and lossy) else DONE


def _failed(failures: Mapping[str, str]) -> list[str]:
    """Return a line for each target that could not be compiled."""
    return [f"{target} is not written: {reason}" for target, reason in failures.items()]


def dropped(losses: Sequence[Mapping[str, str]]) -> list[str]:
    """Return a line per reason for dropped elements: ``gravity is not written: URDF has no world settings``."""
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
