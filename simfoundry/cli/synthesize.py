"""``simfoundry synthesize``."""

from __future__ import annotations

from pathlib import Path

import click

from simfoundry.cli.options import NEW_FOLDER, camera_option, scene_argument
from simfoundry.cli.output import choose_camera, lower_scene, print_json, subcommand


@subcommand(force=True)
@scene_argument
@camera_option
@click.option("-o", "--out", type=NEW_FOLDER, required=True, help="Write the capture into this folder.")
@click.option("--seed", type=int, default=0, show_default=True, help="Seed of the sensor noise.")
@click.option("--masks", is_flag=True, help="Also write instance masks.")
def command(scene: Path, camera: str | None, out: Path, seed: int, masks: bool, force: bool, as_json: bool) -> None:
    """Render a scene to a capture: color and depth with the noise and the holes of a real sensor."""
    from simfoundry.capture.synthesize import CAPTURE_FILES, synthesize
    from simfoundry.runtime.files import ensure_replaceable

    loaded, spec, lowered = lower_scene(scene, as_json)
    view = choose_camera(lowered, spec, camera)
    for name in CAPTURE_FILES:
        ensure_replaceable(out / name, [scene, *loaded.files()], force)
    path = synthesize(lowered, view, out, seed, masks, truth=scene)
    if as_json:
        print_json({"capture": str(path), "camera": view.name, "seed": seed})
    else:
        click.echo(str(path))
