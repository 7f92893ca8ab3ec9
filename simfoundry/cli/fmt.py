"""``simfoundry fmt``."""

from __future__ import annotations

import difflib
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from simfoundry.cli.documents import documents
from simfoundry.cli.output import (
    CANNOT,
    DONE,
    FINDINGS,
    CannotError,
    print_document,
    print_findings,
    print_json,
    subcommand,
    write_in_place,
)
from simfoundry.spec.diagnostics import Diagnostic, SpecError

if TYPE_CHECKING:
    from simfoundry.spec.change.format import Formatted

STDIN = Path("-")


@subcommand()
@click.argument("paths", nargs=-1, type=click.Path(path_type=Path, allow_dash=True))
@click.option("--check", is_flag=True, help="Write nothing, and exit with code 1 if something would change.")
@click.option("--diff", is_flag=True, help="Write nothing, and show the changes.")
def command(paths: tuple[Path, ...], check: bool, diff: bool, as_json: bool) -> int:
    """Rewrite documents in their canonical form, keeping comments and meaning.

    PATHS are files, or folders with documents below them (default: the working folder); `-` reads standard input and
    writes standard output. A file that cannot be read is reported and left unchanged (exit code 2).
    """
    if STDIN in paths:
        if len(paths) > 1 or as_json:
            raise CannotError("`-` cannot be combined with other files or --json")
        return _stream(check, diff)
    texts, findings = _formatted(documents(paths or (Path(),)))
    changed = {path: text for path, text in texts.items() if text.changed}
    if not (check or diff):
        for path, text in changed.items():
            write_in_place(path, text.after)
    if as_json:
        print_json(_report(texts, changed, findings, diff))
    else:
        for path, text in changed.items():
            said = "would change" if check else "wrote"
            click.echo(_diff(path, text) if diff else f"{said} {path}", nl=not diff)
        if findings:
            print_findings(findings)
        if not diff:
            click.echo(_summary(len(texts), len(changed), check))
    return CANNOT if findings else FINDINGS if check and changed else DONE


def _formatted(files: list[Path]) -> tuple[dict[Path, Formatted], list[Diagnostic]]:
    from simfoundry.spec.change.format import format_file

    texts: dict[Path, Formatted] = {}
    findings: list[Diagnostic] = []
    for path in files:
        try:
            texts[path] = format_file(path)
        except SpecError as error:
            findings += error.diagnostics
    return texts, findings


def _stream(check: bool, diff: bool) -> int:
    from simfoundry.spec.change.format import Formatted, format_text
    from simfoundry.spec.diagnostics import Severity

    try:
        before = sys.stdin.buffer.read().decode("utf-8")
    except UnicodeDecodeError:
        raise SpecError([Diagnostic("SF001", Severity.ERROR, "this is not UTF-8 text", "<stdin>")]) from None
    text = Formatted(before, format_text(before, "<stdin>"))
    if diff:
        click.echo(_diff(STDIN, text), nl=False)
    elif not check:
        print_document(text.after)
    return FINDINGS if check and text.changed else DONE


def _diff(path: Path, text: Formatted) -> str:
    before, after = (t.splitlines(keepends=True) for t in (text.before, text.after))
    lines = difflib.unified_diff(before, after, f"{path}", f"{path} (formatted)")
    return "".join(line if line.endswith("\n") else f"{line}\n\\ No newline at end of file\n" for line in lines)


def _report(
    texts: dict[Path, Formatted], changed: dict[Path, Formatted], findings: list[Diagnostic], diff: bool
) -> dict[str, Any]:
    report: dict[str, Any] = {
        "files": [str(p) for p in texts],
        "changed": [str(p) for p in changed],
        "findings": [d.to_json() for d in findings],
    }
    return report | {"diffs": {str(p): _diff(p, t) for p, t in changed.items()}} if diff else report


def _summary(files: int, changed: int, check: bool) -> str:
    count = f"{files} document{'s' if files != 1 else ''}"
    seen = "; `--diff` shows how" if check and changed else ""
    return f"{count}: {changed or 'none'} {'would change' if check else 'changed'}{seen}"
