"""Commands for backgrounds: ``background convert`` and ``background align``."""

from __future__ import annotations

from pathlib import Path

import click

from simfoundry.cli import output
from simfoundry.cli.options import FILE, NEW_FILE, scene_argument


@click.group()
def background_command() -> None:
    """Convert splats, and align the background of a scene."""


@background_command.command("convert")
@click.argument("source", type=FILE)
@click.argument("out", type=NEW_FILE)
@click.option("--in", "scene", type=FILE, help="Scene whose background SOURCE is; OUT is in its world, in meters.")
@output.json_option
@output.force_option
@output.reporting
def convert_command(source: Path, out: Path, scene: Path | None, force: bool, as_json: bool) -> None:
    """Convert a Gaussian splat to another format.

    SOURCE and OUT are PLY, SPZ, GLB (KHR_gaussian_splatting) or USD files; their suffixes state the format.
    """
    from simfoundry.api.backgrounds import convert_splat

    output.protect_output(out, [source, *([scene] if scene is not None else [])], force)
    count = convert_splat(source, out, scene=scene)
    output.print_result(as_json, {"out": str(out), "gaussians": count}, f"{out}: {count} Gaussians")


@background_command.command("align")
@scene_argument
@click.option("--pairs", type=FILE, help="Text file with pairs of points: x y z in the background's file, x y z in the "
              "world [m], and optionally a weight, in each line.")  # fmt: skip
@click.option("--to", "reference", type=FILE, help="Splat or mesh that shows the same surroundings in the world.")
@click.option("--cameras", type=FILE, help="JSON file with poses of the scene's cameras in the background's file, as "
              "matrices. With one camera, the scale is that of the fixed objects' depth.")  # fmt: skip
@click.option("--write", is_flag=True, help="Write the pose and the scale to SCENE. Default: only print them.")
@output.json_option
@output.reporting
def align_command(
    scene: Path, pairs: Path | None, reference: Path | None, cameras: Path | None, write: bool, as_json: bool
) -> None:
    """Find the pose and the scale of a scene's background.

    SCENE has a `background` with a splat or a mesh. Exactly one of --pairs, --to and --cameras is required.
    """
    from simfoundry.api.backgrounds import align_background, write_alignment

    found = align_background(scene, pairs=pairs, reference=reference, cameras=cameras)
    values = found.values
    if write:
        write_alignment(scene, found)
    pose = ", ".join(f"{key}: {value}" for key, value in values["pose"].items())
    text = f"pose: {{{pose}}}\nscale: {values['scale']}\n{found.note}"
    facts = {**values, "error_m": found.error_m, "note": found.note, "written": str(scene) if write else None}
    output.print_result(as_json, facts, f"{text}\nwrote {scene}" if write else text)
