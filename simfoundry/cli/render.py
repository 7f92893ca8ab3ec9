"""``simfoundry render``."""

from __future__ import annotations

from pathlib import Path

import click

from simfoundry.cli.output import choose_camera, force_option, json_option, print_json, reporting


@click.command()
@click.argument("scene", type=click.Path(path_type=Path, exists=True, dir_okay=False))
@click.option("-c", "--camera", help="A camera of the scene; default: its viewpoint, or its first.")
@click.option("-o", "--out", type=click.Path(path_type=Path, dir_okay=False), help="Default: SCENE-CAMERA.png here.")
@click.option(
    "--engine",
    type=click.Choice(["auto", "egl", "osmesa", "raycast"]),
    default="auto",
    show_default=True,
    help="MuJoCo by EGL or OSMesa, or the ray caster, which needs no driver.",
)
@force_option
@json_option
@reporting
def command(scene: Path, camera: str | None, out: Path | None, engine: str, force: bool, as_json: bool) -> None:
    """Render a PNG from a camera, without a display."""
    from simfoundry.assets.cache import Cache
    from simfoundry.render.montage import save_png
    from simfoundry.runtime.outputs import ensure_replaceable
    from simfoundry.scene.lower import lower
    from simfoundry.spec.load import load_scene
    from simfoundry.spec.models.scene import SceneSpec
    from simfoundry.worlds.render import choose_engine, render

    loaded = load_scene(scene)
    assert isinstance(loaded.spec, SceneSpec)
    lowered = lower(loaded, Cache.default())
    view = choose_camera(lowered, loaded.spec, camera)
    chosen = choose_engine(engine)
    target = out or Path(f"{lowered.name}-{view.name}.png")
    ensure_replaceable(target, [scene, *loaded.files()], force)
    save_png(target, render(lowered, view, engine=chosen))
    if as_json:
        print_json({"out": str(target), "camera": view.name, "engine": chosen.value})
    else:
        click.echo(f"{target}  ({view.name}, {view.width} x {view.height}, {chosen})")
