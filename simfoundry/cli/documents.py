"""Commands that check and rewrite documents: ``check``, ``fmt``, ``migrate``."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from simfoundry.cli import output
from simfoundry.cli.options import option, set_option
from simfoundry.errors import SimfoundryError
from simfoundry.spec.check.report import FORMATS
from simfoundry.spec.diagnostics import Diagnostic, SpecError, printable
from simfoundry.spec.project import MARKER, document_files

if TYPE_CHECKING:
    from simfoundry.spec.change.format import Formatted
    from simfoundry.spec.check.report import Checked
    from simfoundry.spec.files import Loaded
    from simfoundry.spec.load import Known


def documents(paths: tuple[Path, ...]) -> list[Path]:
    """Return the given files and the documents below the given folders, without duplicates.

    Files and folders whose names start with a dot, and documents that the project excludes, are skipped unless they
    are specified explicitly.
    """
    files: dict[Path, None] = {}
    excluded = 0
    for path in paths:
        if path.is_dir():
            found = document_files(path)
            excluded += len(found.excluded)
            files |= dict.fromkeys(found.included)
        elif path.exists() or path.is_symlink():  # a broken symbolic link is reported when it is read
            files[path] = None
        else:
            raise SimfoundryError(f"{path} does not exist")
    if not files:
        but = f" except {excluded} excluded by {MARKER}" if excluded else ""
        raise SimfoundryError(f"could not find any documents below {', '.join(map(str, paths))}{but}")
    return list(files)


# Minimum number of documents for which a progress bar is shown on a terminal.
MANY = 100


@output.subcommand()
@click.argument("paths", nargs=-1, type=click.Path(path_type=Path))
@option("--format", "form", type=click.Choice(FORMATS), default="text",
        help="Output format: text, or a format for scripts, code scanning or GitHub.")  # fmt: skip
@click.option("--lints/--no-lints", default=True, help="Also check the geometry, or only the structure.")
@click.option("--fix", is_flag=True, help="First correct what is certain, such as misspelled keys and names.")
@click.option("--diff", is_flag=True, help="With --fix: do not write anything; show the corrections.")
@set_option
def check_command(
    paths: tuple[Path, ...],
    form: str,
    lints: bool,
    fix: bool,
    diff: bool,
    parameters: dict[str, float],
    as_json: bool,
) -> int:
    """Check the given documents, and all documents below the given folders (default: the working folder).

    The exit code is 1 if there are errors or warnings. To see a detailed description of a finding, run `simfoundry
    explain CODE`.
    """
    from simfoundry.runtime.parallel import map_parallel
    from simfoundry.spec.check.report import gather, renderer, summary

    form = "json" if as_json else form
    if diff and not fix:
        raise SimfoundryError("--diff shows corrections, and requires --fix")
    if diff and form not in ("text", "json"):
        raise SimfoundryError(f"--diff cannot be combined with --format {form}")
    files = documents(paths or (Path(),))
    diffs = _fix(files, diff, quiet=form != "text") if fix else {}
    if diff and form == "text":
        for each in diffs.values():
            click.echo(each, nl=False)
        if diffs:
            return output.FINDINGS
        click.echo("nothing can be corrected with certainty")
    _known.clear()
    _linted.clear()
    with output.progress_bar(len(files) < MANY or not sys.stderr.isatty()) as progress:
        checked = map_parallel(
            partial(_check, lints=lints, parameters=parameters),
            files,
            lambda done: progress("check", done / len(files)),
        )
    report = gather(map(str, files), checked)
    if form == "text":
        output.print_findings(list(report.findings))
    elif form == "github" and report.findings:
        click.echo(renderer(form)(report))
    elif diff:
        output.print_json(json.loads(renderer(form)(report)) | {"diffs": diffs})
    elif form != "github":
        output.print_json_text(renderer(form)(report))
    if form in ("text", "github"):
        click.echo(summary(report))
    if form == "text" and report.findings and sys.stdout.isatty():
        click.echo(f"run `simfoundry explain {report.findings[0].code}` for details")
    return output.FINDINGS if report.findings else output.DONE


def _fix(files: list[Path], keep: bool, quiet: bool) -> dict[str, str]:
    """Correct what is certain in documents, and return the differences. With ``keep``, do not write anything."""
    from simfoundry.runtime.files import write_all_in_place
    from simfoundry.spec.change.fixes import certain_fix, fix_documents
    from simfoundry.spec.change.format import Formatted

    fixed = fix_documents(files)
    if not keep:
        write_all_in_place({path: (old.encode(), new.encode()) for path, (old, new) in fixed.texts.items()})
    for finding in fixed.done if not (keep or quiet) else ():
        instead = certain_fix(finding)
        assert instead is not None
        place = f"{finding.file}:{finding.line}:{finding.column}"
        click.echo(printable(f"fixed {place}: replaced `{finding.word}` by `{instead.text.rstrip()}`"))
    return {str(path): _difference(path, Formatted(*texts), "fixed") for path, texts in fixed.texts.items()}


# Documents that this process has read while running the command, by project; shared documents are read only once.
_known: dict[Path, Known] = {}

# Documents that this process has linted while running the command.
_linted: set[Path] = set()


def _check(file: Path, lints: bool, parameters: Mapping[str, float]) -> Checked:
    """Return the findings for one document. This function is also called in worker processes."""
    from simfoundry.spec.check.report import Checked
    from simfoundry.spec.load import load
    from simfoundry.spec.project import project_root

    root = project_root(file)
    loaded = load(file, root, _known.setdefault(root, {}), parameters=parameters)
    findings = loaded.all_findings()
    if lints:
        from simfoundry.lint.lints import lint

        findings += lint(loaded, _linted)
    return Checked(tuple(findings), tuple(map(str, _used(loaded))))


def _used(loaded: Loaded) -> Iterator[Path]:
    """Yield the files that a document extends or refers to, directly or indirectly."""
    yield from loaded.bases
    for used in loaded.uses.values():
        yield used.path
        yield from _used(used)


STDIN = Path("-")


@output.subcommand()
@click.argument("paths", nargs=-1, type=click.Path(path_type=Path, allow_dash=True))
@click.option("--check", is_flag=True, help="Do not write anything; exit with code 1 if a document would change.")
@click.option("--diff", is_flag=True, help="Do not write anything; show the changes.")
def fmt_command(paths: tuple[Path, ...], check: bool, diff: bool, as_json: bool) -> int:
    """Rewrite documents in their canonical form, preserving their comments, layout and meaning.

    PATHS are documents, or folders that contain documents (default: the working folder). `-` reads from standard input
    and writes to standard output. Files that cannot be parsed are reported and left unchanged, and the exit code is 2.
    """
    from simfoundry.spec.change.format import format_file

    if STDIN in paths:
        if len(paths) > 1 or as_json:
            raise SimfoundryError("`-` cannot be combined with other files or --json")
        return _format_stream(check, diff)
    done = _rewrite(documents(paths or (Path(),)), format_file, keep=check or diff)
    diffs = {str(path): _difference(path, text) for path, text in done.changed.items()} if diff else {}
    if as_json:
        output.print_json(done.to_json("changed") | ({"diffs": diffs} if diff else {}))
    else:
        for path in done.changed:
            line = f"{'would change' if check else 'wrote'} {path}"
            click.echo(diffs.get(str(path), line), nl=not diff)
        output.print_findings(done.findings)
    if not (as_json or diff):
        changes = f"{len(done.changed) or 'none'} {'would change' if check else 'changed'}"
        seen = "; `--diff` shows how" if check and done.changed else ""
        click.echo(f"{output.plural(len(done.files), 'document')}: {changes}{seen}")
    return done.exit_code(check)


@output.subcommand()
@click.argument("paths", nargs=-1, type=click.Path(path_type=Path))
@click.option("--check", is_flag=True, help="Do not write anything; exit with code 1 if a document is out of date.")
def migrate_command(paths: tuple[Path, ...], check: bool, as_json: bool) -> int:
    """Update older documents in place to the current version, including keys that were renamed. Comments are kept.

    PATHS are documents, or folders that contain documents (default: the working folder). The first key of a document
    contains its version.
    """
    from simfoundry.spec.change.format import Formatted, migrated
    from simfoundry.spec.yaml.text import read

    def update(path: Path) -> Formatted:
        text = read(path).text
        return Formatted(text, migrated(text, str(path)))

    files = documents(paths or (Path(),))
    done = _rewrite(files, update, keep=check)._replace(files=files)
    if as_json:
        output.print_json(done.to_json("older"))
        return done.exit_code(check)
    for path in done.changed:
        click.echo(f"{'would update' if check else 'updated'} {path}")
    output.print_findings(done.findings)
    click.echo(f"{output.plural(len(done.files), 'document')}: {len(done.changed) or 'none'} out of date")
    return done.exit_code(check)


class _Rewritten(NamedTuple):
    """The result of rewriting documents.

    Attributes:
        files: The documents that could be parsed.
        changed: The new text of each document that changes.
        findings: The findings for the documents that could not be parsed.
    """

    files: list[Path]
    changed: dict[Path, Formatted]
    findings: list[Diagnostic]

    def to_json(self, changed: str) -> dict[str, Any]:
        """Return the report as JSON data. ``changed`` is the key under which the changed documents are listed."""
        files, changes = ([str(path) for path in paths] for paths in (self.files, self.changed))
        return {"files": files, changed: changes, "findings": [d.to_json() for d in self.findings]}

    def exit_code(self, check: bool) -> int:
        """Return the exit code. If ``check`` is set, the exit code is 1 if any document would change."""
        return output.CANNOT if self.findings else output.FINDINGS if check and self.changed else output.DONE


def _rewrite(files: list[Path], change: Callable[[Path], Formatted], keep: bool) -> _Rewritten:
    """Apply a change to documents and, unless ``keep`` is set, write the documents that changed."""
    from simfoundry.spec.yaml.nodes import YamlError

    done = _Rewritten([], {}, [])
    for path in files:
        try:
            text = change(path)
        except YamlError as error:
            done.findings.append(error.diagnostic(str(path)))
        except SpecError as error:
            done.findings.extend(error.diagnostics)
        else:
            done.files.append(path)
            if text.changed:
                done.changed[path] = text
    for path, text in done.changed.items() if not keep else ():
        output.write_in_place(path, text.after)
    return done


def _format_stream(check: bool, diff: bool) -> int:
    """Format a document from standard input and write it to standard output."""
    from simfoundry.spec.change.format import Formatted, format_text
    from simfoundry.spec.diagnostics import Severity

    try:
        before = sys.stdin.buffer.read().decode("utf-8")
    except UnicodeDecodeError:
        message = "the text could not be decoded as UTF-8"
        raise SpecError([Diagnostic("SF001", Severity.ERROR, message, "<stdin>")]) from None
    text = Formatted(before, format_text(before, "<stdin>"))
    if diff:
        click.echo(_difference(STDIN, text), nl=False)
    elif not check:
        output.print_document(text.after)
    return output.FINDINGS if check and text.changed else output.DONE


def _difference(path: Path, text: Formatted, what: str = "formatted") -> str:
    """Return a unified diff between a document and its changed version."""
    return output.unified_diff(text.before, text.after, f"{path}", f"{path} ({what})")
