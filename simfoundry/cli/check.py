"""``simfoundry check``."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from simfoundry.cli.documents import documents
from simfoundry.cli.output import DONE, FINDINGS, print_findings, print_json_text, progress_bar, subcommand
from simfoundry.spec.check.report import FORMATS

if TYPE_CHECKING:
    from simfoundry.spec.check.report import Checked
    from simfoundry.spec.files import Loaded
    from simfoundry.spec.load import Known

MANY = 100
"""Number of documents from which a terminal shows a progress bar."""


@subcommand()
@click.argument("paths", nargs=-1, type=click.Path(path_type=Path))
@click.option(
    "--format", "form", type=click.Choice(FORMATS), default="text", show_default=True,
    help="Output format: text, or a format for scripts, code scanning or GitHub.",
)  # fmt: skip
@click.option("--lints/--no-lints", default=True, help="Check geometry as well, or only the structure.")
def command(paths: tuple[Path, ...], form: str, lints: bool, as_json: bool) -> int:
    """Check documents, or every document below the given folders (default: the working folder).

    The exit code is 1 if there is an error or a warning. `simfoundry explain CODE` describes a finding in detail.
    """
    from simfoundry.runtime.parallel import map_parallel
    from simfoundry.spec.check.report import gather, renderer

    form = "json" if as_json else form
    files = documents(paths or (Path(),))
    _known.clear()
    _linted.clear()
    with _progress(len(files)) as progress:
        checked = map_parallel(partial(_check, lints=lints), files, progress)
    report = gather(map(str, files), checked)
    if form == "text":
        print_findings(list(report.findings))
    elif form == "github" and report.findings:
        click.echo(renderer(form)(report))
    elif form != "github":
        print_json_text(renderer(form)(report))
    if form in ("text", "github"):
        from simfoundry.spec.check.report import summary

        click.echo(summary(report))
    if form == "text" and report.findings and sys.stdout.isatty():
        click.echo(f"run `simfoundry explain {report.findings[0].code}` for details")
    return FINDINGS if report.findings else DONE


_known: dict[Path, Known] = {}
"""Documents that this process has read during a command, by project; shared documents are read once."""

_linted: set[Path] = set()
"""Documents that this process has linted during a command."""


def _check(file: Path, lints: bool) -> Checked:
    """Return the findings of one document; also called in worker processes."""
    from simfoundry.spec.check.report import Checked
    from simfoundry.spec.load import load
    from simfoundry.spec.project import project_root

    root = project_root(file)
    loaded = load(file, root, _known.setdefault(root, {}))
    findings = loaded.all_findings()
    if lints:
        from simfoundry.lint.run import lint

        findings += lint(loaded, _linted)
    return Checked(tuple(findings), tuple(map(str, _used(loaded))))


def _used(loaded: Loaded) -> Iterator[Path]:
    """Return the files that a document extends or refers to, transitively."""
    yield from loaded.bases
    for used in loaded.uses.values():
        yield used.path
        yield from _used(used)


@contextmanager
def _progress(count: int) -> Iterator[Callable[[int], object]]:
    """Report how many of ``count`` documents are done if a terminal is attached."""
    if count < MANY or not sys.stderr.isatty():
        yield lambda done: None
        return
    with progress_bar(False) as show:
        yield lambda done: show("check", done / count)
