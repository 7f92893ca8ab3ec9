"""``simfoundry render``."""

from __future__ import annotations

from pathlib import Path

import click

from simfoundry.cli.options import NEW_FILE, camera_option, scene_argument
from simfoundry.cli.output import choose_camera, lower_scene, print_json, subcommand


@subcommand(force=True)
@scene_argument
@camera_option
@click.option("-o", "--out", type=NEW_FILE, help="Write to this file. Default: SCENE-CAMERA.png.")
@click.option(
    "--engine", type=click.Choice(["auto", "egl", "osmesa", "raycast"]), default="auto", show_default=True,
    help="Renderer: MuJoCo with EGL or OSMesa, or the ray caster, which needs no driver.",
)  # fmt: skip
def command(scene: Path, camera: str | None, out: Path | None, engine: str, force: bool, as_json: bool) -> None:
    """Render a PNG from a camera of a scene, without a display."""
    from simfoundry.render.montage import save_png
    from simfoundry.runtime.files import ensure_replaceable
    from simfoundry.worlds.render import choose_engine, render

    loaded, spec, lowered = lower_scene(scene, as_json)
    view = choose_camera(lowered, spec, camera)
    chosen = choose_engine(engine)
    target = out or Path(f"{lowered.name}-{view.name}.png")
    ensure_replaceable(target, [scene, *loaded.files()], force)
    save_png(target, render(lowered, view, engine=chosen))
    if as_json:
        print_json({"out": str(target), "camera": view.name, "engine": chosen.value})
    else:
        click.echo(f"{target}  ({view.name}, {view.width} x {view.height}, {chosen})")
