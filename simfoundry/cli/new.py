"""``simfoundry new``."""

from __future__ import annotations

from pathlib import Path

import click

from simfoundry.cli.options import FILE
from simfoundry.cli.output import CannotError, print_json, subcommand

NEXT = {
    "scene": ("simfoundry check {path}", "simfoundry show {path}"),
    "task": ("simfoundry check {path}",),
    "asset": ("simfoundry check {path}",),
    "capture": ("put color.png and depth.png into {folder}", "simfoundry check {path}", "simfoundry capture {folder}"),
    "cousins": ("simfoundry check {path}",),
    "policy": ("simfoundry check {path}",),
}
"""Next steps for a new document of each kind."""


@subcommand()
@click.argument("words", nargs=-1, required=True, metavar="[KIND] PATH")
@click.option("--name", help="Name of the document. Default: the name of its file.")
@click.option("--from", "source", type=FILE, metavar="SCENE",
              help="The scene of a task or the twin of a recipe. Default: the only scene beside PATH.")  # fmt: skip
@click.option("--extends", type=FILE, metavar="DOCUMENT",
              help="Create an overlay that states only the differences from this document.")  # fmt: skip
@click.option("--force", is_flag=True, help="Replace an existing file.")
def command(
    words: tuple[str, ...], name: str | None, source: Path | None, extends: Path | None, force: bool, as_json: bool
) -> None:
    """Create a valid document with comments that explain its keys.

    KIND is scene, task, asset, capture, cousins or policy; it may be omitted if PATH implies it, as desk.scene.yaml
    does. If no folder above PATH is a project (with a simfoundry.yaml or a .git), a simfoundry.yaml is written to the
    working folder, or to the closest folder that contains every file named. If the project has no editor schemas, they
    are written to .simfoundry/schemas/.
    """
    from simfoundry.runtime.files import write_atomically
    from simfoundry.spec.editor.new import NewError, kind_and_path, make

    try:
        kind, path = kind_and_path(words)
        if path.exists() and not force:
            raise CannotError(f"{path} exists; --force replaces it")
        new = make(kind, path, name, source, extends)
    except NewError as error:
        raise CannotError(str(error)) from None
    for file, text in {**new.marker, **new.schemas, new.path: new.text}.items():
        write_atomically(file, text.encode())
    written = sorted({str(file.parent) for file in new.schemas})
    steps = [step.format(path=path, folder=path.parent) for step in NEXT[kind]]
    if as_json:
        marker = next((str(file) for file in new.marker), None)
        print_json({"file": str(path), "kind": kind, "schemas": written, "project": marker, "next": steps})
        return
    click.echo(f"wrote {path}")
    for file in new.marker:
        click.echo(f"wrote {_shown(str(file))}, which marks the root of the project")
    for folder in written:
        click.echo(f"wrote {_shown(folder)}/, which editors use for completion and checks")
    click.echo("next:")
    for step in steps:
        click.echo(f"  {step}")


def _shown(folder: str) -> str:
    """Return a path relative to the working folder if it lies below it."""
    path, here = Path(folder), Path.cwd()
    return str(path.relative_to(here)) if path.is_relative_to(here) else folder
