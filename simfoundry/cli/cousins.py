"""``simfoundry cousins``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from simfoundry.cli.options import FILE, NEW_FILE, NEW_FOLDER, resumable
from simfoundry.cli.options import shard as shard_of
from simfoundry.cli.output import DONE, FINDINGS, print_json, progress_bar, subcommand

if TYPE_CHECKING:
    from simfoundry.cousins.recipe.candidate import ImpossibleError
    from simfoundry.cousins.recipe.document import Recipe
    from simfoundry.cousins.run.run import Ledger, RunPlan


@subcommand(force=True)
@click.argument("recipe", type=FILE)
@click.option(
    "-n", "--count", type=click.IntRange(1, 1_000_000),
    help="Number of cousins to make. Default: the recipe's.",
)  # fmt: skip
@click.option(
    "-o", "--out", type=NEW_FOLDER,
    help="Write into this folder, inside the twin's project. Default: build/NAME.",
)  # fmt: skip
@click.option("-j", "--jobs", type=click.IntRange(1, 256), help="Number of processes. Default: one per core.")
@click.option("--seed", type=click.IntRange(0, 2**63 - 1), help="Use this seed instead of the recipe's.")
@click.option("--shard", callback=shard_of, metavar="I/N", help="Examine every N-th candidate, starting with the I-th.")
@click.option("--on", "where", type=click.Choice(["local", "ray"]), default="local", show_default=True)
@click.option(
    "--gallery", type=click.IntRange(0, 1000), default=24, show_default=True,
    help="Number of pictures on the page.",
)  # fmt: skip
@click.option("--no-gallery", is_flag=True, help="Do not draw pictures.")
@click.option("--vlm", default="", metavar="MODEL", help="Use this model for recipes that need one.")
@click.option("--stage", type=NEW_FILE, help="Also write a USD stage with all cousins as variants.")
def command(
    recipe: Path,
    count: int | None,
    out: Path | None,
    jobs: int | None,
    seed: int | None,
    shard: tuple[int, int] | None,
    where: str,
    gallery: int,
    no_gallery: bool,
    vlm: str,
    stage: Path | None,
    force: bool,
    as_json: bool,
) -> int:
    """Make variants of a scene or task that preserve its affordances.

    Each cousin is a document in OUT that extends the twin and states only the differences. OUT/manifest.json lists the
    cousins and every rejected candidate with the reasons; OUT/gallery.html shows the first cousins. The same recipe and
    seed give the same bytes. To resume an interrupted run, repeat the command; to combine shards written to one folder,
    run it without --shard.

    The exit code is 1 if there are fewer cousins, or fewer variants of an object, than requested.
    """
    from simfoundry.cousins.recipe.candidate import ImpossibleError
    from simfoundry.cousins.recipe.variant_pool import ASSETS, counts
    from simfoundry.cousins.run.candidates import FUNCTION, CandidateSampler, SamplerSetup
    from simfoundry.cousins.run.run import RunPlan, begin, run
    from simfoundry.cousins.run.worker_pools import Work, open_pool

    if stage is not None:
        from simfoundry.runtime.files import ensure_replaceable

        ensure_replaceable(stage, [recipe], force)
    read, folder = _read(recipe, seed, out)
    setup = SamplerSetup(str(recipe.absolute()), str(folder), read.seed, vlm)
    with progress_bar(as_json) as progress, resumable(folder):
        progress("the twin", 0.0)
        try:
            plan = RunPlan(folder, count or read.spec.count, read.about(), shard)
            begin(plan)
            sampler = CandidateSampler.load(setup)
            sampler.require_possible()
        except ImpossibleError as error:
            return _impossible(error, as_json)
        made = counts(read.spec.object, folder / ASSETS / "objects")
        plan = replace(plan, most=sampler.pool.most, variants=made)

        def heard(ledger: Ledger) -> None:
            from simfoundry.cousins.run.report import told

            progress(told(ledger), len(ledger.accepted) / ledger.wanted)

        ledger = run(plan, lambda: open_pool(Work(FUNCTION, (setup,)), where, jobs), heard)
        if shard is None:
            _write(plan, ledger, read, 0 if no_gallery else gallery, stage, progress)
    return _report(plan, ledger, read.remarks, as_json)


def _read(recipe: Path, seed: int | None, out: Path | None) -> tuple[Recipe, Path]:
    """Return the recipe and the output folder, which from now on belongs to the twin's project."""
    from simfoundry.cousins.recipe.document import claim_project, read_recipe

    read = read_recipe(recipe, seed)
    folder = (out or read.scene.root / "build" / read.spec.name).absolute()
    marker = claim_project(read, folder)
    if marker is not None:
        click.echo(f"wrote {marker}, which marks the root of the project", err=True)
        read = read_recipe(recipe, seed)  # the marker may have enlarged the project of its documents
    return read, folder


def _write(
    plan: RunPlan,
    ledger: Ledger,
    recipe: Recipe,
    pictures: int,
    stage: Path | None,
    progress: Callable[[str, float], None],
) -> None:
    """Write all outputs except the cousins, which are already there; delete the logs last."""
    from simfoundry.cousins.run.report import write_manifest
    from simfoundry.cousins.run.run import finish
    from simfoundry.reports.gallery import write_gallery

    write_manifest(plan, ledger)
    if pictures:
        write_gallery(plan, ledger, pictures, lambda done, of: progress("pictures", done / of))
    if stage is not None:
        from simfoundry.cousins.run.report import write_stage

        write_stage(plan, ledger, recipe, stage)
    finish(plan, ledger)


def _impossible(error: ImpossibleError, as_json: bool) -> int:
    if as_json:
        print_json({"end": "impossible", "accepted": 0, "reasons": [reason.to_json() for reason in error.reasons]})
    for reason in error.reasons if not as_json else ():
        click.echo(f"impossible: {reason.text}", err=True)
    return FINDINGS


def _report(plan: RunPlan, ledger: Ledger, remarks: tuple[str, ...], as_json: bool) -> int:
    from simfoundry.cousins.run.report import examples, summary
    from simfoundry.cousins.run.run import LEAST_RATE, MANIFEST, PATIENCE

    facts = {**summary(plan, ledger), "out": str(plan.out), "remarks": list(remarks)}
    short = len(ledger.accepted) < ledger.wanted
    end = FINDINGS if short or any(count.is_short for count in plan.variants) else DONE
    if as_json:
        print_json(facts | ({"shard": list(plan.shard)} if plan.shard is not None else {}))
        return end
    share = "" if plan.shard is None else f" of shard {plan.shard[0]}/{plan.shard[1]}"
    click.echo(
        f"{len(ledger.accepted)} of {ledger.wanted} cousins{share}; {ledger.examined} candidates examined, "
        f"{ledger.rate:.1%} accepted"
    )
    for count in plan.variants:
        click.echo(f"{count}", err=count.is_short)
    for code, text in examples(ledger).items():
        click.echo(f"  {ledger.totals[code]:>6}  {code:<14} {text}", err=short)
    for text in ledger.unchecked:
        click.echo(f"not checked: {text}", err=True)
    for text in remarks:
        click.echo(f"note: {text}", err=True)
    if ledger.end == "hopeless":
        click.echo(
            f"stopped: of at least {PATIENCE} candidates, fewer than {LEAST_RATE:.1%} were accepted; the reasons "
            "above show which constraints to relax",
            err=True,
        )
    elif short:
        click.echo(f"the recipe has only these {ledger.examined} candidates", err=True)
    where = plan.out / MANIFEST if plan.shard is None else plan.out
    click.echo(f"{where}" + ("" if plan.shard is None else "  (a run without --shard writes the cousins)"))
    return end
