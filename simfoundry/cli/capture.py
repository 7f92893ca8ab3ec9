"""``simfoundry capture``."""

from __future__ import annotations

from pathlib import Path

import click

from simfoundry.cli.options import ANY, NEW_FOLDER
from simfoundry.cli.output import DONE, FINDINGS, print_json, progress_bar, subcommand
from simfoundry.cli.settle import settle_table


@subcommand()
@click.argument("capture", type=ANY)
@click.option("-o", "--out", type=NEW_FOLDER, help="Write the scene into this folder. Default: build/<capture name>.")
@click.option("--frame", help="Reconstruct this frame. Default: the first.")
@click.option("--force", is_flag=True, help="Replace the output folder even if it contains other files or your edits.")
@click.option("--strict", is_flag=True, help="Exit with code 1 if an object was left out or did not settle well.")
def command(capture: Path, out: Path | None, frame: str | None, force: bool, strict: bool, as_json: bool) -> int:
    """Reconstruct a capture (a folder with capture.yaml, color and depth) as a settled scene with meshes.

    Writes NAME.scene.yaml, meshes/, report.json and compare.png. If an object was left out, or did not settle well, the
    table and the report name it and give the reason.
    """
    from simfoundry.assets.cache import Cache
    from simfoundry.capture.run import run_capture

    target = out or Path("build") / _name(capture)
    with progress_bar(as_json) as progress:
        run = run_capture(capture, target, frame, progress, Cache.default(), force)
    verdict = FINDINGS if strict and not run.report["passed"] else DONE
    if as_json:
        print_json({"scene": str(run.scene_file), **run.report})
        return verdict
    click.echo(settle_table(run.settled.to_json()["objects"]))
    for reason in run.reconstruction.skipped:
        click.echo(f"not reconstructed: {reason}")
    click.echo(f"{run.scene_file}  {len(run.reconstruction.shapes)} objects; pictures in {target / 'compare.png'}")
    return verdict


def _name(capture: Path) -> str:
    """Return the name of a capture: its folder's name, or NAME for NAME.capture.yaml."""
    if capture.is_dir() or capture.name == "capture.yaml":
        return (capture if capture.is_dir() else capture.parent).resolve().name
    return capture.name.split(".")[0]
