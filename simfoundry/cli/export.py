"""``simfoundry export``."""

from __future__ import annotations

from pathlib import Path

import click

from simfoundry.cli.options import FILE, NEW_FILE
from simfoundry.cli.output import DONE, FINDINGS, CannotError, print_document, print_json, subcommand


@subcommand(force=True)
@click.argument("task", type=FILE)
@click.option(
    "-f", "--format", "format_", required=True, type=click.Choice(["libero", "behavior", "omnigibson"]),
    help="Write BDDL for LIBERO or BEHAVIOR, or the task YAML of the paper's release.",
)  # fmt: skip
@click.option("-o", "--out", type=NEW_FILE, help="Write to this file. Default: standard output.")
@click.option("--strict", is_flag=True, help="Exit with code 1 if something was left out or assumed.")
def command(task: Path, format_: str, out: Path | None, force: bool, strict: bool, as_json: bool) -> int:
    """Write a task as BDDL, or in the format of the paper's release.

    A goal that the format cannot express is an error; parts of the initial state that it cannot express are reported.
    `simfoundry import` reads all three formats.
    """
    from simfoundry.assets.cache import Cache
    from simfoundry.frontends.task_export import export_task
    from simfoundry.runtime.files import ensure_replaceable, write_atomically
    from simfoundry.scene.lower import lower_file
    from simfoundry.spec.load import load_kind
    from simfoundry.spec.models.task import TaskSpec

    loaded = load_kind(task, "task/1")
    spec = loaded.spec
    assert isinstance(spec, TaskSpec)
    if out is not None:
        ensure_replaceable(out, [task, *loaded.files()], force)
    if as_json and out is None:
        raise CannotError("--json needs an output file; name it with `-o FILE`")
    export = export_task(spec, lower_file(task.parent / spec.scene, Cache.default(), fetch=False), format_)
    if out is None:
        print_document(export.text)
    else:
        write_atomically(out, export.text.encode())
    if as_json:
        print_json({"source": str(task), "out": str(out), "format": format_, "notes": export.notes})
    else:
        for note in export.notes:
            click.echo(f"differs from the task: {note}", err=True)
    return FINDINGS if strict and export.notes else DONE
