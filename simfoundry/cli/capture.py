"""``simfoundry capture``."""

from __future__ import annotations

from pathlib import Path

import click

from simfoundry.cli.output import CannotError, json_option, print_json, progress_bar, reporting
from simfoundry.cli.settle import settle_table


@click.command()
@click.argument("capture", type=click.Path(path_type=Path, exists=True))
@click.option("-o", "--out", type=click.Path(path_type=Path, file_okay=False), help="Default: build/<capture name>.")
@click.option("--frame", help="The frame to reconstruct; default: the first.")
@click.option("--force", is_flag=True, help="Replace the output folder even where it holds files of your own.")
@json_option
@reporting
def command(capture: Path, out: Path | None, frame: str | None, force: bool, as_json: bool) -> None:
    """Turn a capture (a folder with capture.yaml, colour and depth) into a settled scene with meshes.

    Writes NAME.scene.yaml, meshes/, report.json and compare.png. Objects that do not come to rest are named in the
    table and in the report.
    """
    from simfoundry.assets.cache import Cache
    from simfoundry.capture.run import run_capture

    target = out or Path("build") / (capture.resolve().name if capture.is_dir() else capture.stem.split(".")[0])
    if target.exists() and any(target.iterdir()) and not (target / "report.json").exists() and not force:
        raise CannotError(f"{target} holds files that no capture wrote; choose another folder, or say --force")
    with progress_bar(as_json) as progress:
        run = run_capture(capture, target, frame, progress, Cache.default())
    if as_json:
        print_json({"scene": str(run.scene_file), **run.report})
        return
    click.echo(settle_table(run.settled.to_json()["objects"]))
    for reason in run.reconstruction.skipped:
        click.echo(f"not reconstructed: {reason}")
    click.echo(f"{run.scene_file}  {len(run.reconstruction.shapes)} objects; pictures in {target / 'compare.png'}")
