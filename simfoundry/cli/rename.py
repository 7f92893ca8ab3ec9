"""The command ``rename``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from simfoundry.cli import output

if TYPE_CHECKING:
    from simfoundry.spec.names.rename import DocumentEdit


@output.subcommand()
@click.argument("file", type=click.Path(path_type=Path))
@click.argument("old")
@click.argument("new")
@click.option(
    "--kind", default="", metavar="KIND", help="Kind of the name, such as `joint`, if several things have it."
)
@click.option("--dry-run", is_flag=True, help="Do not write anything; show the changes.")
def rename_command(file: Path, old: str, new: str, kind: str, dry_run: bool, as_json: bool) -> int:
    """Rename OLD to NEW in every document of the project of FILE that names it.

    OLD is a name in FILE, such as `mug`, a name of a member, such as `cabinet.drawer`, or a name with its section, such
    as `materials.oak`. Everything else in the documents stays as it is, including comments and layout. Nothing is
    written if NEW is taken, or if `check` would find a new error.
    """
    from simfoundry.runtime.files import write_all_in_place
    from simfoundry.spec.names.plan import plan_rename
    from simfoundry.spec.names.rename import shown_path

    plan = plan_rename(file, old, new, kind)
    if not dry_run:
        write_all_in_place({edit.file: (edit.before.encode(), edit.after.encode()) for edit in plan.edits})
    shown = {shown_path(edit.file): edit for edit in plan.edits}
    places = sum(len(edit.edits) for edit in plan.edits)
    if as_json:
        output.print_json(
            {
                "kind": plan.symbol.kind,
                "old": plan.symbol.name,
                "new": new,
                "written": not dry_run,
                "files": {
                    path: [{"line": e.line, "column": e.column, "start": e.start, "end": e.end} for e in edit.edits]
                    for path, edit in shown.items()
                },
                "diffs": {path: _difference(path, edit) for path, edit in shown.items()},
                "notes": list(plan.notes),
            }
        )
        return output.DONE
    for path, edit in shown.items() if dry_run else ():
        click.echo(_difference(path, edit), nl=False)
    counted = f"{output.plural(places, 'place')} in {output.plural(len(plan.edits), 'document')}"
    click.echo(f"{'would rename' if dry_run else 'renamed'} {plan.symbol} to `{new}`: {counted}")
    for path, edit in shown.items() if not dry_run else ():
        click.echo(f"  {path}: {len(edit.edits)}")
    for note in plan.notes:
        click.echo(f"note: {note}")
    return output.DONE


def _difference(path: str, edit: DocumentEdit) -> str:
    return output.unified_diff(edit.before, edit.after, path, f"{path} (renamed)")
