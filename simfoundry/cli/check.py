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
    from simfoundry.spec.load import Known
    from simfoundry.spec.loaded import Loaded

MANY = 100
"""From so many documents on, a terminal shows how far the check is."""


@subcommand()
@click.argument("paths", nargs=-1, type=click.Path(path_type=Path))
@click.option(
    "--format", "form", type=click.Choice(FORMATS), default="text", show_default=True,
    help="Choose text for people, or a format for scripts, code scanning or GitHub.",
)  # fmt: skip
@click.option("--lints/--no-lints", default=True, help="Look at geometry too, or at the structure alone.")
def command(paths: tuple[Path, ...], form: str, lints: bool, as_json: bool) -> int:
    """Check documents, or every document below folders (default: the working folder).

    The exit code is 1 if there is an error or a warning. `simfoundry explain CODE` says more about a finding.
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
        click.echo(f"`simfoundry explain {report.findings[0].code}` says more")
    return FINDINGS if report.findings else DONE


_known: dict[Path, Known] = {}
"""Documents read by this process during a command, by project, so that shared ones are read once."""

_linted: set[Path] = set()
"""Documents linted by this process during a command."""


def _check(file: Path, lints: bool) -> Checked:
    """Return the findings of one document; also called in other processes."""
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
    """The files that a document extends and refers to, and so on from there."""
    yield from loaded.bases
    for used in loaded.uses.values():
        yield used.path
        yield from _used(used)


@contextmanager
def _progress(count: int) -> Iterator[Callable[[int], object]]:
    """Shows how many of ``count`` documents are done, where somebody may wait for them at a terminal."""
    if count < MANY or not sys.stderr.isatty():
        yield lambda done: None
        return
    with progress_bar(False) as show:
        yield lambda done: show("check", done / count)
