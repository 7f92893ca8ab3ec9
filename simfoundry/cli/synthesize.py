"""``simfoundry synthesize``."""

from __future__ import annotations

from pathlib import Path

import click

from simfoundry.cli.output import choose_camera, force_option, json_option, print_json, reporting


@click.command()
@click.argument("scene", type=click.Path(path_type=Path, exists=True, dir_okay=False))
@click.option("-c", "--camera", help="A camera of the scene; default: its viewpoint, or its first.")
@click.option(
    "-o", "--out", type=click.Path(path_type=Path, file_okay=False), required=True, help="The capture folder."
)
@click.option("--seed", type=int, default=0, show_default=True, help="Seed of the sensor noise.")
@click.option("--masks", is_flag=True, help="Write instance masks too.")
@force_option
@json_option
@reporting
def command(scene: Path, camera: str | None, out: Path, seed: int, masks: bool, force: bool, as_json: bool) -> None:
    """Render a scene to a capture: colour and depth as a real sensor would see them, with its noise and holes."""
    from simfoundry.assets.cache import Cache
    from simfoundry.capture.synthesize import CAPTURE_FILES, synthesize
    from simfoundry.runtime.outputs import ensure_replaceable
    from simfoundry.scene.lower import lower
    from simfoundry.spec.load import load_scene
    from simfoundry.spec.models.scene import SceneSpec

    loaded = load_scene(scene)
    assert isinstance(loaded.spec, SceneSpec)
    lowered = lower(loaded, Cache.default())
    view = choose_camera(lowered, loaded.spec, camera)
    for name in CAPTURE_FILES:
        ensure_replaceable(out / name, [scene, *loaded.files()], force)
    path = synthesize(lowered, view, out, seed, masks, truth=scene)
    if as_json:
        print_json({"capture": str(path), "camera": view.name, "seed": seed})
    else:
        click.echo(str(path))
