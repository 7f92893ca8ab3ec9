"""``simfoundry diff``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from simfoundry.cli.options import NEW_FILE
from simfoundry.cli.output import CANNOT, DONE, FINDINGS, CannotError, print_json, subcommand
from simfoundry.spec.diagnostics import printable

if TYPE_CHECKING:
    from simfoundry.spec.change.compare import DocumentComparison


@subcommand(as_json=False, force=True)
@click.argument("what", nargs=-1, metavar="[REVISION|A..B]... [FILE]...")
@click.option("--format", "form", type=click.Choice(["text", "json", "html"]), default="text", show_default=True)
@click.option("-o", "--out", type=NEW_FILE, help="Write the HTML page to this file.")
@click.option("--exit-code", is_flag=True, help="Exit with code 1 if there is a difference.")
@click.option("-v", "--verbose", is_flag=True, help="Also show differences without effect, such as a different order.")
@click.option("--git", "driver", is_flag=True, help="Act as git's diff driver.")
def command(
    what: tuple[str, ...], form: str, out: Path | None, exit_code: bool, verbose: bool, driver: bool, force: bool
) -> int | None:
    """Show the changes in a document in terms of the scene.

    Pass two files, or revisions of one file: `HEAD~1 desk.scene.yaml` compares that revision with the working file, and
    `main..feature desk.scene.yaml` compares two revisions. The default revision is HEAD. Without a file, every document
    that differs is shown.
    """
    if driver:
        return _driver(what)
    import tempfile

    from simfoundry.spec.change.git.arguments import open_pair, pairs

    if (form == "html") != (out is not None):
        raise CannotError("an HTML page needs an output file; give `--format html` and `-o PAGE.html` together")
    if out is not None:
        from simfoundry.runtime.files import ensure_replaceable

        ensure_replaceable(out, map(Path, what), force)
    with tempfile.TemporaryDirectory(prefix="simfoundry-") as folder:
        found = [open_pair(pair, Path(folder) / str(k), verbose) for k, pair in enumerate(pairs(what))]
        if out is not None:
            from simfoundry.reports.comparison import page
            from simfoundry.runtime.files import write_atomically

            write_atomically(out, page(found).encode())
    if form == "json":
        print_json({"documents": [plain(c) for c in found]})
    elif form == "text":
        _print(found)
    else:
        click.echo(f"{out}  ({len(found)} document{'s' if len(found) != 1 else ''})")
    if form != "json":
        _print_findings(found)
    if any(c.obstacle for c in found):
        return CANNOT
    return FINDINGS if exit_code and any(c.differs for c in found) else DONE


def _driver(arguments: tuple[str, ...]) -> int:
    from simfoundry.spec.change.git.driver import driver_lines

    for line in driver_lines(arguments, Path.cwd()):
        click.echo(printable(line))
    return DONE


def _print(found: list[DocumentComparison]) -> None:
    for comparison in found:
        if len(found) > 1:
            click.echo(printable(comparison.name))
        for line in comparison.lines():
            click.echo(("  " if len(found) > 1 else "") + printable(line))
    if not found:
        click.echo("no document differs")


def _print_findings(found: list[DocumentComparison]) -> None:
    from simfoundry.spec.diagnostics import render

    findings = [d for c in found for d in c.findings]
    texts = {s.label: s.text for c in found for s in (c.old, c.new) if s is not None}
    if findings:
        click.echo(render(findings, texts=texts), err=True)


def plain(comparison: DocumentComparison) -> dict[str, Any]:
    """Return the changes as plain data."""
    from dataclasses import asdict

    from simfoundry.spec.change.diff.changes import to_json
    from simfoundry.spec.change.diff.words import summary

    return {
        "name": comparison.name,
        "old": comparison.old.label if comparison.old is not None else None,
        "new": comparison.new.label if comparison.new is not None else None,
        "obstacle": comparison.obstacle or None,
        "summary": summary(comparison.entries),
        "entries": [asdict(e) for e in comparison.entries],
        "changes": [to_json(c) for c in comparison.changes],
        "findings": [d.to_json() for d in comparison.findings],
    }
