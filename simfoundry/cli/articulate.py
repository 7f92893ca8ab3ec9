"""The command ``articulate``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, cast

import click

from simfoundry.cli import output
from simfoundry.cli.options import ANY, NEW_FILE, commercial_only_option
from simfoundry.errors import SimfoundryError

if TYPE_CHECKING:
    from simfoundry.capture.articulation.segments import Front

FRONTS = ("-y", "+y", "+x", "-x")


class _Pixels(click.ParamType):  # type: ignore[type-arg]  # generic only from click 8.4 on; 8.1 is supported
    """Whole numbers, separated by commas."""

    name = "pixels"

    def convert(
        self, value: str | tuple[int, ...], param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[int, ...]:
        """Return the numbers."""
        if isinstance(value, tuple):
            return value
        try:
            return tuple(int(number) for number in value.split(","))
        except ValueError:
            self.fail(f"`{value}` is not a list of whole numbers, such as 412,210", param, ctx)


PIXELS = _Pixels()


@output.subcommand(force=True)
@click.argument("source", type=ANY)
@click.argument("opened", type=ANY, nargs=-1)
@click.option("-o", "--out", type=NEW_FILE, required=True, help="Write the asset to this file, NAME.asset.yaml.")
@click.option("--frame", help="Name of the frame in both captures. Default: the first.")
@click.option("--hinge", nargs=2, type=PIXELS, metavar="U,V U,V", help="Two pixels on the hinge in the first capture.")
@click.option("--box", type=PIXELS, metavar="L,T,R,B", help="Box around the part in the first capture [px].")
@click.option(
    "--joint",
    "joints",
    multiple=True,
    metavar="NAME=SEGMENTS:TYPE:...",
    help="A joint of a mesh, such as door=3,4:revolute:front_left:front:90; can be repeated.",
)
@click.option("--front", type=click.Choice(FRONTS), help="Side of a mesh that is its front, with z up. Default: -y.")
@commercial_only_option
def articulate_command(
    source: Path,
    opened: tuple[Path, ...],
    out: Path,
    frame: str | None,
    hinge: tuple[tuple[int, ...], tuple[int, ...]] | None,
    box: tuple[int, ...] | None,
    joints: tuple[str, ...],
    front: str | None,
    commercial_only: bool,
    force: bool,
    as_json: bool,
) -> int:
    """Find the joints of an object, and write it as an asset.

    SOURCE and OPENED are captures of an object, shut and opened; several OPENED show more of its range. The camera must
    stay where it is between them, or each states its `pose`. The joint is found without a model. State --hinge or
    --box if you know better; they always win.

    If there is only SOURCE, it is a mesh (.glb, .obj, .stl or .ply, in meters). Its parts come from the model for
    `parts`, by default the pieces that are not connected, and its joints from --joint or the model for `articulate`.

    The picture beside the asset shows the motion. The exit code is 1 if a joint is doubtful; a person's values in the
    asset always win.
    """
    if not opened:
        if frame or hinge or box:
            raise SimfoundryError("--frame, --hinge and --box are for captures; state joints of a mesh with --joint")
        if source.is_dir():
            raise SimfoundryError(f"{source} is a folder: add a capture of the same object opened, or name a mesh file")
        return _articulate_mesh(source, out, joints, cast("Front", front or "-y"), commercial_only, force, as_json)
    if joints or front:
        raise SimfoundryError("--joint and --front are for a mesh; two captures show the joint themselves")
    from simfoundry.capture.articulation.run import articulate, picture_of
    from simfoundry.models.setup import load_setup

    for path in (out, picture_of(out)):
        output.protect_output(path, [source, *opened], force)
    setup = load_setup(source, commercial_only=True) if commercial_only else None
    with output.progress_bar(as_json) as progress:
        found = articulate(source, opened, out, frame, progress, _hinge(hinge), _box(box), setup)
    output.print_result(as_json, found.to_json(), found.summary())
    return output.FINDINGS if found.doubt else output.DONE


def _hinge(pixels: tuple[tuple[int, ...], tuple[int, ...]] | None) -> tuple[tuple[int, int], tuple[int, int]] | None:
    if pixels is None:
        return None
    if any(len(pixel) != 2 for pixel in pixels):
        raise SimfoundryError("--hinge takes two pixels, such as --hinge 412,210 412,330")
    (a, b), (c, d) = pixels
    return (a, b), (c, d)


def _box(sides: tuple[int, ...] | None) -> tuple[int, int, int, int] | None:
    if sides is None:
        return None
    if len(sides) != 4:
        raise SimfoundryError("--box takes left,top,right,bottom in pixels, such as --box 300,200,420,340")
    left, top, right, bottom = sides
    return left, top, right, bottom


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
