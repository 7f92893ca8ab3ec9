"""Commands that propose variants and tasks: ``cousins``, ``propose``."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click

from simfoundry.cli import output
from simfoundry.cli.options import (
    FILE,
    NEW_FILE,
    NEW_FOLDER,
    WorldName,
    commercial_only_option,
    jobs_option,
    on_option,
    option,
    resumable,
    scene_argument,
)
from simfoundry.cli.options import shard as shard_of
from simfoundry.errors import SimfoundryError
from simfoundry.runtime.executors import Machines

if TYPE_CHECKING:
    from simfoundry.cousins.recipe.document import Recipe
    from simfoundry.cousins.run.run import Ledger, RunPlan
    from simfoundry.cousins.tasks.context import TaskContext


@output.subcommand(force=True)
@click.argument("recipe", type=FILE)
@click.option("-n", "--count", type=click.IntRange(1, 1_000_000),
              help="Number of cousins to make. Default: the count in the recipe.")  # fmt: skip
@click.option("-o", "--out", type=NEW_FOLDER, help="Output folder, inside the twin's project. Default: build/NAME.")
@jobs_option(None)
@click.option("--seed", type=click.IntRange(0, 2**63 - 1), help="Random seed, which overrides the seed in the recipe.")
@click.option("--shard", callback=shard_of, metavar="I/N", help="Examine every N-th candidate, starting with the I-th.")
@on_option
@option("--gallery", type=click.IntRange(0, 1000), default=24, help="Number of images on the gallery page.")
@click.option("--no-gallery", is_flag=True, help="Do not write the gallery page.")
@click.option("--vlm", default="", metavar="MODEL", help="Model to use for recipes that require one.")
@click.option("--stage", type=NEW_FILE, help="Also write a USD stage with all cousins as variants.")
@click.option("--preview", type=NEW_FILE, help="Also write a PNG sheet with the twin and the first 15 cousins.")
@click.option("--split", default="", metavar="NAME", help="Draw the values of `vary` only from this split.")
@commercial_only_option
def cousins_command(
    recipe: Path, count: int | None, out: Path | None, jobs: int | None, seed: int | None,
    shard: tuple[int, int] | None, machines: Machines, gallery: int, no_gallery: bool, vlm: str, stage: Path | None,
    preview: Path | None, split: str, commercial_only: bool, force: bool, as_json: bool,
) -> int:  # fmt: skip
    """Make variants of a scene or task that preserve its affordances.

    Each cousin is a document in OUT that extends the twin and contains only the differences. OUT/manifest.json lists
    the cousins and every rejected candidate with the reasons, and OUT/gallery.html shows the first cousins. The output
    is fully determined by the recipe and the seed. To resume an interrupted run, repeat the command. To combine shards
    that were written to the same folder, run the command without --shard.

    The exit code is 1 if there are fewer cousins, or fewer variants of an object, than requested.
    """
    from simfoundry.cousins.recipe.candidate import ImpossibleError
    from simfoundry.cousins.recipe.variant_pool import ASSETS, counts
    from simfoundry.cousins.run.candidates import FUNCTION, CandidateSampler
    from simfoundry.cousins.run.report import told, write_manifest, write_preview, write_stage
    from simfoundry.cousins.run.run import RunPlan, begin, finish, run
    from simfoundry.cousins.run.worker_pools import Work, open_pool
    from simfoundry.reports.gallery import write_gallery

    output.protect_output(stage, [recipe], force)
    output.protect_output(preview, [recipe], force)
    read, folder = _read(recipe, seed, out, split)
    setup = recipe.absolute(), folder, read.seed, vlm, split, commercial_only
    with output.progress_bar(as_json) as progress, resumable(folder):
        progress("the twin", 0.0)
        try:
            plan = RunPlan(folder, count or read.spec.count, read.about(), shard)
            begin(plan)
            sampler = CandidateSampler.load(*setup)
            sampler.require_possible()
        except ImpossibleError as error:
            if as_json:
                output.print_json({"end": "impossible", "accepted": 0, "reasons": [r.to_json() for r in error.reasons]})
            for reason in error.reasons if not as_json else ():
                click.echo(f"impossible: {reason.text}", err=True)
            return output.FINDINGS
        made = counts(read.spec.object, folder / ASSETS / "objects")
        plan = replace(plan, most=sampler.pool.most, variants=made, varied=read.varied_summary)

        def report(ledger: Ledger) -> None:
            progress(told(ledger), len(ledger.accepted) / ledger.wanted)

        ledger = run(plan, lambda: open_pool(Work(FUNCTION, setup), machines, jobs), report)
        if shard is None:
            write_manifest(plan, ledger)
            if gallery and not no_gallery:
                write_gallery(plan, ledger, gallery, lambda done, of: progress("pictures", done / of))
            if stage is not None:
                write_stage(plan, ledger, read, stage)
                if read.varied:
                    click.echo("note: the stage contains objects and poses, but no other values of `vary`", err=True)
            if preview is not None:
                write_preview(plan, ledger, read.scene.path, preview)
            finish(plan, ledger)
    return _report_run(plan, ledger, read.remarks, as_json)


def _read(recipe: Path, seed: int | None, out: Path | None, split: str) -> tuple[Recipe, Path]:
    """Read the recipe, choose the output folder, and make the folder part of the twin's project."""
    from simfoundry.cousins.recipe.document import claim_project, read_recipe

    read = read_recipe(recipe, seed, split)
    folder = (out or read.scene.root / "build" / read.spec.name).absolute()
    marker = claim_project(read, folder)
    if marker is not None:
        click.echo(f"wrote {marker}, which marks the root of the project", err=True)
        read = read_recipe(recipe, seed, split)  # the marker may have added documents to the project
    return read, folder


def _report_run(plan: RunPlan, ledger: Ledger, remarks: tuple[str, ...], as_json: bool) -> int:
    from simfoundry.cousins.run.report import examples, summary
    from simfoundry.cousins.run.run import LEAST_RATE, MANIFEST, PATIENCE

    facts = {**summary(plan, ledger), "out": str(plan.out), "remarks": list(remarks)}
    short = len(ledger.accepted) < ledger.wanted
    end = output.FINDINGS if short or any(count.is_short for count in plan.variants) else output.DONE
    if as_json:
        output.print_json(facts | ({"shard": list(plan.shard)} if plan.shard is not None else {}))
        return end
    share = "" if plan.shard is None else f" of shard {plan.shard[0]}/{plan.shard[1]}"
    accepted = f"{len(ledger.accepted)} of {ledger.wanted} cousins{share}"
    click.echo(f"{accepted}; {ledger.examined} candidates examined, {ledger.rate:.1%} accepted")
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
            f"stopped: fewer than {LEAST_RATE:.1%} of at least {PATIENCE} candidates were accepted; the reasons "
            "above show which constraints to relax",
            err=True,
        )
    elif short:
        click.echo(f"the recipe allows only {ledger.examined} candidates", err=True)
    where = plan.out / MANIFEST if plan.shard is None else plan.out
    click.echo(f"{where}" + ("" if plan.shard is None else "  (to write the cousins, run the command without --shard)"))
    return end


@output.subcommand(force=True)
@scene_argument
@option("-n", "count", type=click.IntRange(1, 1000), default=20, help="Number of tasks to propose.")
@click.option("-o", "--out", type=NEW_FOLDER, help="Write the task documents into this folder.")
@option("--seed", type=click.IntRange(0), default=0, help="Seed for the order of the proposals.")
@click.option("--about", multiple=True, metavar="OBJECT",
              help="Propose only tasks that involve this object; may be repeated.")  # fmt: skip
@click.option("--payload", type=click.FloatRange(0, min_open=True),
              help="Robot payload [kg]. Default: the known payload of the robot model.")  # fmt: skip
@click.option("--vlm", metavar="MODEL",
              help="Ask this model, such as `openai:gpt-5`, instead of enumerating affordances.")  # fmt: skip
@click.option("--base-url", metavar="URL", help="Address of a server with an OpenAI-compatible API.")
@commercial_only_option
@option("--form", type=click.Choice(["typed", "paper"]), default="typed",
        help="Format of the model's response: typed, or the text format used in the paper.")  # fmt: skip
@click.option("-c", "--camera", help="Camera whose image is sent to the model. Default: the scene's first.")
@click.option("--engine", "engines", type=WorldName(), multiple=True, default=("mujoco",),
              help="Engine that checks whether reached goals persist; may be repeated. Default: MuJoCo.")  # fmt: skip
@click.option("--rejected", is_flag=True, help="Also list rejected tasks, with the reasons.")
def propose_command(
    scene: Path, count: int, out: Path | None, seed: int, about: tuple[str, ...], payload: float | None,
    vlm: str | None, base_url: str | None, commercial_only: bool, form: Literal["typed", "paper"], camera: str | None,
    engines: tuple[str, ...], rejected: bool, force: bool, as_json: bool,
) -> int:  # fmt: skip
    """Propose tasks for a scene, from its affordances or a model's suggestions, each verified to be feasible.

    A task is accepted if all names in it exist, its goal does not already hold, a physically stable state in which the
    goal holds can be found, a robot can reach and grasp the objects, and it is not equivalent to another accepted task.
    The exit code is 1 if there are fewer tasks than requested.
    """
    from simfoundry.assets.cache import Cache
    from simfoundry.cousins.tasks.context import TaskContext
    from simfoundry.cousins.tasks.enumeration import checked, enumerate_tasks, scene_reference, write
    from simfoundry.cousins.tasks.enumeration import to_json as row
    from simfoundry.spec.diagnostics import nearest

    folder = out or scene.parent
    context = TaskContext.load(scene, Cache.default(), payload, engines)
    names = [o.name for o in context.twin.scene.objects]
    for name in about:
        if name not in names:
            raise SimfoundryError(f"no object is called `{name}`; {nearest(name, names)}")
    reference = scene_reference(scene, folder)
    if vlm is not None:
        from simfoundry.cousins.tasks.proposals import propose_tasks
        from simfoundry.models.open import open_vlm
        from simfoundry.models.setup import load_setup

        model: Any = open_vlm(load_setup(scene, commercial_only=commercial_only), vlm, base_url)
        found = propose_tasks(model, context, _picture(context, scene, camera), count, form, reference, about)
    else:
        with output.progress_bar(as_json) as bar:

            def report(accepted: int, tried: int) -> None:
                bar(f"{tried} tried", accepted / count)

            found = enumerate_tasks(context, count, seed, reference, about, progress=report)
    found = checked(found, folder)
    accepted = [proposal for proposal in found if proposal.accepted]
    files = write(found, out, force) if out is not None else []
    if as_json:
        output.print_json({"accepted": len(accepted), "seen": len(found), "proposals": [row(p, folder) for p in found]})
    else:
        shown = found if rejected else accepted
        width = max((len(p.name) for p in shown), default=0)
        for proposal in shown:
            instruction = proposal.task.instruction if proposal.task is not None else proposal.goal
            mark = "+" if proposal.accepted else "-"
            click.echo(f"{mark} {proposal.name:<{width}}  {proposal.goal}  {instruction}")
            for reason in proposal.reasons:
                click.echo(f"    {reason.code}: {reason.text}")
        click.echo(f"{len(accepted)} tasks, {len(found) - len(accepted)} not accepted")
        if files:
            click.echo(f"wrote {len(files)} documents to {out}")
    return output.DONE if len(accepted) >= min(count, len(found)) and accepted else output.FINDINGS


def _picture(context: TaskContext, scene: Path, name: str | None) -> bytes:
    """Render the scene from a camera and return the image as PNG data."""
    from simfoundry.render.montage import png_bytes
    from simfoundry.spec.load import load_scene
    from simfoundry.spec.models.scene import SceneSpec
    from simfoundry.worlds.render import choose_engine, render

    spec = load_scene(scene).spec
    assert isinstance(spec, SceneSpec)
    camera = output.choose_camera(context.twin.scene, spec, name)
    return png_bytes(render(context.twin.scene, camera, engine=choose_engine("auto")))
