"""Commands that reconstruct from images: ``capture``, ``demo``."""

from __future__ import annotations

from collections.abc import Callable, Collection
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from simfoundry.cli import output
from simfoundry.cli.options import ANY, FILE, FOLDER, NEW_FOLDER, commercial_only_option, option
from simfoundry.cli.scenes import settle_table

if TYPE_CHECKING:
    from simfoundry.capture.run import CaptureRun
    from simfoundry.capture.tasks import TaskRequest
    from simfoundry.models.setup import ModelSetup


@output.subcommand("status")
@click.argument("out", type=FOLDER)
def status_command(out: Path, as_json: bool) -> int:
    """Tell which stages of a reconstruction are cached, stale, or overridden by a person.

    OUT is the output folder of `simfoundry capture`. A new run reuses the results of cached stages and runs stale ones
    again. The exit code is 1 if anything is stale.
    """
    from simfoundry.capture.inputs import examine

    states = examine(out)
    lines = [f"{s.stage:<10}{s.object:<22}{s.state}" for s in states]
    output.print_result(as_json, {"stages": [s.to_json() for s in states]}, "\n".join(lines))
    return output.FINDINGS if any(s.state == "stale" for s in states) else output.DONE


class _WithStatus(click.Command):
    """A command that runs ``status`` if this is its first argument."""

    def make_context(
        self, info_name: str | None, args: list[str], parent: click.Context | None = None, **extra: Any
    ) -> click.Context:
        if args[:1] == ["status"]:
            return status_command.make_context(f"{info_name} status", args[1:], parent, **extra)
        return super().make_context(info_name, args, parent, **extra)


@output.subcommand(cls=_WithStatus)
@click.argument("capture", type=ANY)
@click.option("-o", "--out", type=NEW_FOLDER, help="Output folder for the scene. Default: build/<capture name>.")
@click.option("--frame", help="Name of the frame to reconstruct. Default: the first.")
@click.option("--force", is_flag=True, help="Replace the output folder even if it contains other files or your edits.")
@click.option("--from", "redo_from", metavar="STAGE", help="Run this stage and the later ones again, even if cached.")
@click.option("--only", multiple=True, metavar="OBJECT", help="Run stages again only for this object. Repeatable.")
@click.option(
    "--against", type=FILE, metavar="TRUTH", help="Compare the scene with this ground truth, a scene document."
)
@click.option("--cad", type=FOLDER, help="Folder of meshes, in meters, that objects may be, instead of the stated one.")
@click.option("--accept", "codes", multiple=True, metavar="CODE", help="Accept findings with this code. Repeatable.")
@click.option("--tasks", type=click.IntRange(1, 1000), metavar="N", help="Also write N tasks that the scene affords.")
@click.option("--watch", is_flag=True, help="Keep running, and reconstruct again after each change that you save.")
@commercial_only_option
def capture_command(
    capture: Path,
    out: Path | None,
    frame: str | None,
    force: bool,
    redo_from: str | None,
    only: tuple[str, ...],
    against: Path | None,
    cad: Path | None,
    codes: tuple[str, ...],
    tasks: int | None,
    watch: bool,
    commercial_only: bool,
    as_json: bool,
) -> int:
    """Reconstruct a capture (a folder with capture.yaml, color and depth) as a settled scene with meshes.

    Writes NAME.scene.yaml, meshes/, report.json, compare.png and segments.png. If anything about the scene is doubtful,
    such as an object that was left out or did not settle well, the scene is written all the same, the findings are
    printed and added to the report, and the exit code is 1. `--accept` goes on without the findings of one code.

    A new run repeats only what depends on what has changed, and keeps your edits of the scene, of masks.png and of
    masks.yaml. `simfoundry capture status OUT` lists the stages. `--watch` keeps running, and does this after each
    change.

    No model is needed. One that is configured for `read_scene` names the objects, and estimates their masses.

    `--tasks` writes NAME.task.yaml files, each verified as `simfoundry propose` does. If the model for `read_scene` is
    one of a provider, it proposes them.

    An object that a mesh of the folder `--cad` explains better than a solid becomes that mesh.

    `--against` prints the measures of the paper. The camera in TRUTH has the name of the frame, or is the only one.
    """
    from simfoundry.capture.shared_modules import SHARED_MODULES
    from simfoundry.runtime.process_pair import ProcessPair

    with ProcessPair() as pair:
        pair.start(SHARED_MODULES)  # it imports these modules while this process imports its own
        from simfoundry.assets.cache import Cache
        from simfoundry.capture.findings import accepted_codes
        from simfoundry.capture.run import CaptureOptions, run_capture
        from simfoundry.models.setup import load_setup
        from simfoundry.reports.capture import capture_page

        accepted, models = accepted_codes(codes), load_setup(capture, commercial_only=commercial_only)
        request = None if tasks is None else _task_request(tasks, models)
        options = CaptureOptions(
            frame, force, accepted, redo_from, only, against, capture_page, models, request, cad, pair
        )

        def reconstruct(options: CaptureOptions) -> CaptureRun:
            with output.progress_bar(as_json) as progress:
                run = run_capture(capture, out or _default_out(capture), progress, Cache.default(), options)
            _print_run(run, accepted, as_json)
            return run

        run = reconstruct(options)
        if watch:
            again = partial(reconstruct, replace(options, force=False, redo_from=None, only=()))
            run = _follow(run, again, as_json)
    return output.DONE if run.report["passed"] else output.FINDINGS


def _follow(run: CaptureRun, again: Callable[[], CaptureRun], as_json: bool) -> CaptureRun:
    """Run a capture again after each change, until the user interrupts it, and return the last run."""
    from simfoundry.capture.watch import follow

    last = run

    def attempt(**_options: bool) -> None:
        nonlocal last
        last = again()

    def once_more() -> CaptureRun | None:
        before = last
        try:
            output.reporting(attempt)(as_json=as_json)
        except click.ClickException as error:  # what cannot be used now may be complete after the next change
            error.show()
        return None if last is before else last

    with suppress(KeyboardInterrupt):
        follow(run, once_more, lambda: click.echo("watching for changes; press Ctrl-C to end", err=True))
    return last


def _default_out(capture: Path) -> Path:
    """Return the output folder of a capture: called as its folder, or NAME if its file is called NAME.capture.yaml."""
    folder = capture if capture.is_dir() else capture.parent
    is_named = capture.is_file() and capture.name != "capture.yaml"
    return Path("build") / (capture.name.split(".")[0] if is_named else folder.resolve().name)


def _print_run(run: CaptureRun, accepted: Collection[str], as_json: bool) -> None:
    """Print how the objects settled, the findings, the accuracy and the tasks if there are any, and the files."""
    from simfoundry.reports.capture import accuracy_text

    if as_json:
        stages = [{"stage": name, "object": label, "state": state} for (name, label), state in run.states.items()]
        output.print_json({"scene": str(run.scene_file), **run.report, "stages": stages})
        return
    click.echo(settle_table(run.settled.objects))
    for finding in run.findings:
        click.echo(finding.text() + (" (accepted)" if finding.code in accepted else ""))
    if run.accuracy is not None:
        click.echo(f"\n{accuracy_text(run.accuracy.to_json())}\n")
    for task, instruction in run.report.get("tasks", {}).items():
        click.echo(f"task {task}: {instruction}")
    page = run.scene_file.with_name("report.html")
    click.echo(f"{run.scene_file}  {len(run.reconstruction.shapes)} objects; pictures in {page}")


def _task_request(count: int, models: ModelSetup) -> TaskRequest:
    from simfoundry.assets.cache import Cache
    from simfoundry.cousins.tasks.scene_tasks import task_request
    from simfoundry.models.open import open_provider

    return task_request(count, Cache.default(), open_provider(models, "read_scene"))


@output.subcommand()
@click.argument("capture", type=ANY, required=False)
@option("-o", "--out", type=NEW_FOLDER, default=Path("build/demo"))
@click.option("--frame", help="Reconstruct this frame. Default: the first.")
@click.option("--force", is_flag=True, help="Replace the output folder even if it contains other files or your edits.")
def demo_command(capture: Path | None, out: Path, frame: str | None, force: bool, as_json: bool) -> None:
    """Reconstruct a scene from one image, compile and simulate it, and run a small task with a robot arm.

    CAPTURE is a folder that contains capture.yaml. The default is an included capture of a desk, for which the ground
    truth is known.
    """
    from simfoundry.capture.demo import own_capture, run_demo
    from simfoundry.evaluate.demo import demonstrate
    from simfoundry.reports.capture import accuracy_text, capture_page

    folder = capture or own_capture()
    with output.progress_bar(as_json) as progress:
        demo = run_demo(folder, out, frame, lambda stage, share: progress(stage, 0.7 * share), force, capture_page)
        progress("running a task with an arm", 0.7)
        arm = demonstrate(demo.run.scene_file, out / "arm", force)
    if as_json:
        output.print_json(demo.to_json() | {"arm": arm.to_json()})
        return
    click.echo(f"recovered {len(demo.run.reconstruction.shapes)} objects from {folder}\n")
    click.echo(settle_table(demo.run.settled.objects))
    if demo.comparison is not None:
        click.echo("\ncomparison with the ground truth")
        click.echo(_truth_table([c.to_json() for c in demo.comparison.objects]))
        click.echo(f"\n{accuracy_text(demo.comparison.to_json())}")
    click.echo("\nmotion in 2 s of simulation")
    for engine, motions in demo.motions.items():
        text = motions
        if not isinstance(motions, str):
            worst, turned = max(motions, key=lambda m: m.moved), max(m.turned_deg for m in motions)
            text = f"at most {worst.moved * 1000:.2f} mm ({worst.name}) and {turned:.2f} deg"
        click.echo(f"{engine:<9} {text}")
    click.echo("\ntask with a robot arm")
    if arm.task is None:
        click.echo(f"not run: {arm.reason}")
    else:
        result = f"done in {arm.seconds:.1f} s" if arm.success else f"failed after {arm.seconds:.1f} s: {arm.reason}"
        click.echo(f"“{arm.instruction}”  {result}")
    click.echo("\ncompiled")
    for target, path in demo.worlds.items():
        click.echo(f"{target:<9} {path}")
    click.echo(f"\nscene     {demo.run.scene_file}\npicture   {demo.picture}")
    if arm.task is not None:
        click.echo(f"task      {arm.task}\npictures  {arm.strip}")


def _truth_table(rows: list[dict[str, Any]]) -> str:
    head = f"{'true':<10}{'recovered as':<16}{'position':>9}  {'size, true -> recovered [cm]':<36}"
    lines = [f"{head}{'mass [kg]':<16}{'F1@1cm':>6}"]
    for r in rows:
        if not r["recovered"]:
            lines.append(f"{r['name']:<10}not found")
            continue
        sizes = " -> ".join(" ".join(f"{100 * v:.1f}" for v in r[key]) for key in ("size_true", "size"))
        masses = f"{r['mass_true']:.2g} -> {r['mass']:.2g}"
        place = f"{r['name']:<10}{r['recovered']:<16}{r['position'] * 1000:>6.1f} mm"
        lines.append(f"{place}  {sizes:<36}{masses:<16}{r['f1']:>6.2f}")
    return "\n".join(lines)
