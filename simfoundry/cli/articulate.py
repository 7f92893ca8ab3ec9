"""The command ``articulate``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, cast

import click

from simfoundry.cli import output
from simfoundry.cli.options import ANY, NEW_FILE
from simfoundry.errors import SimfoundryError

if TYPE_CHECKING:
    from simfoundry.capture.articulation.segments import Front

FRONTS = ("-y", "+y", "+x", "-x")


@output.subcommand(force=True)
@click.argument("source", type=ANY)
@click.argument("opened", type=ANY, required=False)
@click.option("-o", "--out", type=NEW_FILE, required=True, help="Write the asset to this file, NAME.asset.yaml.")
@click.option("--frame", help="Name of the frame in both captures. Default: the first.")
@click.option(
    "--joint",
    "joints",
    multiple=True,
    metavar="NAME=SEGMENTS:TYPE:...",
    help="A joint of a mesh, such as door=3,4:revolute:front_left:front:90; can be repeated.",
)
@click.option("--front", type=click.Choice(FRONTS), help="Side of a mesh that is its front, with z up. Default: -y.")
@click.option("--commercial-only", is_flag=True, help="Refuse models that may not be used commercially.")
def articulate_command(
    source: Path,
    opened: Path | None,
    out: Path,
    frame: str | None,
    joints: tuple[str, ...],
    front: str | None,
    commercial_only: bool,
    force: bool,
    as_json: bool,
) -> int:
    """Find the joints of an object, and write it as an asset.

    SOURCE and OPENED are two captures of an object, shut and opened. The camera must stay where it is between them, or
    each states its `pose`. The joint is found without a model.

    If there is only SOURCE, it is a mesh (.glb, .obj, .stl or .ply, in meters). Its parts come from the model for
    `parts`, by default the pieces that are not connected, and its joints from --joint or the model for `articulate`.

    The picture beside the asset shows the motion. The exit code is 1 if a joint is doubtful; a person's values in the
    asset always win.
    """
    if opened is None:
        if frame is not None:
            raise SimfoundryError("--frame is for captures; a mesh has no frames")
        return _articulate_mesh(source, out, joints, cast("Front", front or "-y"), commercial_only, force, as_json)
    if joints or front:
        raise SimfoundryError("--joint and --front are for a mesh; two captures show the joint themselves")
    from simfoundry.capture.articulation.run import articulate, picture_of

    for path in (out, picture_of(out)):
        output.protect_output(path, [source, opened], force)
    with output.progress_bar(as_json) as progress:
        found = articulate(source, opened, out, frame, progress)
    output.print_result(as_json, found.to_json(), found.summary())
    return output.FINDINGS if found.doubt else output.DONE


def _articulate_mesh(
    mesh: Path, out: Path, joints: tuple[str, ...], front: Front, commercial_only: bool, force: bool, as_json: bool
) -> int:
    from simfoundry.capture.articulation.from_mesh import articulate_mesh
    from simfoundry.capture.articulation.run import picture_of
    from simfoundry.models.setup import load_setup

    for path in (out, picture_of(out)):
        output.protect_output(path, [mesh], force)
    setup = load_setup(out.parent, commercial_only=commercial_only)
    with output.progress_bar(as_json) as progress:
        found = articulate_mesh(mesh, out, setup, joints, front, progress)
    output.print_result(as_json, found.to_json(), found.summary())
    return output.FINDINGS if found.doubt else output.DONE
