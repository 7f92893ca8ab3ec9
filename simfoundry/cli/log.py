"""``simfoundry log``."""

from __future__ import annotations

from itertools import islice
from typing import TYPE_CHECKING, Any

import click

from simfoundry.cli.diff import plain
from simfoundry.cli.output import CannotError, print_json, subcommand
from simfoundry.spec.diagnostics import printable

if TYPE_CHECKING:
    from simfoundry.spec.change.git.arguments import HistoryEntry


@subcommand()
@click.argument("what", nargs=-1, metavar="[REVISION|A..B] FILE", required=True)
@click.option("-n", "--max-count", type=click.IntRange(1), metavar="N", help="Show at most N commits.")
@click.option("-v", "--verbose", is_flag=True, help="Also show differences without effect, such as a different order.")
def command(what: tuple[str, ...], max_count: int | None, verbose: bool, as_json: bool) -> None:
    """Show what each commit changed in a document, in terms of the scene, latest first.

    Changes in documents that it extends or refers to are included, each as of its commit. The history is that of HEAD,
    of a revision, or of a range such as `main..feature`.
    """
    from simfoundry.spec.change.git.arguments import document_history

    steps = islice(document_history(what, verbose), max_count)
    if as_json:
        print_json({"commits": [_plain(step) for step in steps]})
        return
    shown = 0
    for step in steps:
        shown += 1
        about = step.commit
        click.echo(printable(f"{about.id[:10]} {about.date[:10]} {about.author}: {about.subject}"))
        for line in step.comparison.lines():
            click.echo(f"  {printable(line)}")
    if not shown:
        raise CannotError(f"no commit in this history changes {what[-1]}")


def _plain(step: HistoryEntry) -> dict[str, Any]:
    about = step.commit
    head = {"commit": about.id, "date": about.date, "author": about.author, "subject": about.subject}
    return {**head, **plain(step.comparison)}
