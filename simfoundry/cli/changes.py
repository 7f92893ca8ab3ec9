"""Commands that compare and combine versions of documents: ``diff``, ``log``, ``merge``."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click

from simfoundry.cli import output
from simfoundry.cli.options import NEW_FILE, NEW_FOLDER, option
from simfoundry.errors import SimfoundryError
from simfoundry.spec.diagnostics import Diagnostic, SpecError, printable, render

if TYPE_CHECKING:
    from simfoundry.spec.change.compare import DocumentComparison
    from simfoundry.spec.change.git.history import HistoryEntry
    from simfoundry.spec.change.merge.texts import MergedText


@output.subcommand(as_json=False, force=True)
@click.argument("what", nargs=-1, metavar="[REVISION|A..B]... [FILE]...")
@option("--format", "form", type=click.Choice(["text", "json", "html", "markdown"]), default="text")
@click.option("-o", "--out", type=NEW_FILE, help="Write the HTML page or the Markdown report to this file.")
@click.option("--pictures", type=NEW_FOLDER, help="Write images for the Markdown report to this folder.")
@click.option("--pictures-url", metavar="URL", help="Address of that folder for readers. Default: its relative path.")
@click.option("--exit-code", is_flag=True, help="Exit with code 1 if there are differences.")
@click.option("-v", "--verbose", is_flag=True, help="Also show differences without effect, such as a different order.")
@click.option("--git", "driver", is_flag=True, help="Act as git's diff driver.")
def diff_command(
    what: tuple[str, ...], form: str, out: Path | None, pictures: Path | None, pictures_url: str | None,
    exit_code: bool, verbose: bool, driver: bool, force: bool,
) -> int | None:  # fmt: skip
    """Show changes to a document in terms of the scene.

    Pass two files, or revisions of one file: `HEAD~1 desk.scene.yaml` compares a revision with the working file, and
    `main..feature desk.scene.yaml` compares two revisions. The default revision is HEAD. If no file is specified, all
    documents that differ are shown.
    """
    import tempfile

    from simfoundry.spec.change.git.arguments import open_pair, pairs
    from simfoundry.spec.change.git.driver import driver_lines

    if driver:
        for line in driver_lines(what, Path.cwd()):
            click.echo(printable(line))
        return output.DONE

    _check_outputs(form, out, pictures, pictures_url)
    output.protect_output(out, map(Path, what), force)
    with tempfile.TemporaryDirectory(prefix="simfoundry-") as folder:
        found = [open_pair(pair, Path(folder) / str(k), verbose) for k, pair in enumerate(pairs(what))]
        if form == "html" and out is not None:
            from simfoundry.reports.comparison import page

            output.write_text(out, page(found))
        elif form == "markdown":
            _write_markdown(found, out, pictures, pictures_url, force)
    if form == "json":
        output.print_json({"documents": [_plain(c) for c in found]})
    elif form == "text":
        _print_comparisons(found)
    elif out is not None:
        click.echo(f"{out}  ({output.plural(len(found), 'document')})")
    findings = [d for c in found for d in c.findings]
    if findings and form not in ("json", "markdown"):
        texts = {s.label: s.text for c in found for s in (c.old, c.new) if s is not None}
        click.echo(render(findings, texts=texts), err=True)
    if any(c.obstacle for c in found):
        return output.CANNOT
    return output.FINDINGS if exit_code and any(c.differs for c in found) else output.DONE


def _check_outputs(form: str, out: Path | None, pictures: Path | None, url: str | None) -> None:
    if form == "html" and out is None:
        raise SimfoundryError("an HTML page requires an output file; use `--format html` and `-o PAGE.html` together")
    if form not in ("html", "markdown") and out is not None:
        raise SimfoundryError(f"`-o {out}` is for pages and reports; add `--format html` or `--format markdown`")
    if pictures is not None and form != "markdown":
        raise SimfoundryError("`--pictures` is for `--format markdown`; an HTML page contains its images")
    if url is not None and pictures is None:
        raise SimfoundryError("`--pictures-url` requires `--pictures FOLDER`, to which the images are written")


def _write_markdown(
    found: Sequence[DocumentComparison], out: Path | None, folder: Path | None, url: str | None, force: bool
) -> None:
    """Write the report to a file or to the screen, and its images to a folder."""
    import os

    from simfoundry.reports.markdown import PictureFiles, markdown_report

    pictures = None
    if folder is not None:
        start = out.resolve().parent if out is not None else Path.cwd()
        pictures = PictureFiles(url or Path(os.path.relpath(folder.resolve(), start)).as_posix())
    report = markdown_report([comparison for comparison in found if not comparison.identical], pictures)
    if folder is not None and pictures is not None:
        for name in pictures.files:
            output.protect_output(folder / name, force=force)
        for name, png in pictures.files.items():
            output.write_bytes(folder / name, png)
    if out is not None:
        output.write_text(out, report)
    else:
        output.print_document(report)


def _print_comparisons(found: list[DocumentComparison]) -> None:
    for comparison in found:
        if len(found) > 1:
            was = f" (renamed from {comparison.was})" if comparison.was else ""
            click.echo(printable(f"{comparison.name}{was}"))
        for line in comparison.lines():
            click.echo(("  " if len(found) > 1 else "") + printable(line))
    if not found:
        click.echo("no document differs")


def _plain(comparison: DocumentComparison) -> dict[str, Any]:
    """Return the changes as plain data."""
    from dataclasses import asdict

    from simfoundry.spec.change.diff.changes import to_json
    from simfoundry.spec.change.diff.words import summary

    return {
        "name": comparison.name,
        "was": comparison.was or None,
        "old": comparison.old and comparison.old.label,
        "new": comparison.new and comparison.new.label,
        "obstacle": comparison.obstacle or None,
        "summary": summary(comparison.entries),
        "entries": [asdict(e) for e in comparison.entries],
        "changes": [to_json(c) for c in comparison.changes],
        "findings": [d.to_json() for d in comparison.findings],
    }


@output.subcommand()
@click.argument("what", nargs=-1, metavar="[REVISION|A..B] FILE", required=True)
@click.option("-n", "--max-count", type=click.IntRange(1), metavar="N", help="Show at most N commits.")
@click.option("-v", "--verbose", is_flag=True, help="Also show differences without effect, such as a different order.")
def log_command(what: tuple[str, ...], max_count: int | None, verbose: bool, as_json: bool) -> None:
    """Show what each commit changed in a document, in terms of the scene, latest first.

    Each version is read with the documents that it extended and referred to at that time, so their changes are
    included. Changes that are not committed come first. The history can be limited to a revision, or to a range such as
    `main..feature`, which lists commits only.
    """
    from simfoundry.spec.change.git.arguments import document_history

    entries = []
    for entry in _at_most(max_count, document_history(what, verbose)):
        commit = entry.commit
        head = {
            "commit": commit and commit.id,
            "date": commit and commit.date,
            "author": commit and commit.author,
            "subject": commit.subject if commit else UNCOMMITTED,
        }
        entries.append(head | {"note": entry.note or None} | _plain(entry.comparison) if as_json else head)
        if not as_json:
            click.echo(printable(f"{commit.id[:10]} {commit.date[:10]} {commit.author}: {commit.subject}")
                       if commit else UNCOMMITTED)  # fmt: skip
            for line in entry.lines():
                click.echo(f"  {printable(line)}")
    if as_json:
        output.print_json({"commits": entries})
    elif not entries:
        raise SimfoundryError(f"no commit in this history changes {what[-1]}")


UNCOMMITTED = "uncommitted changes"


def _at_most(count: int | None, entries: Iterator[HistoryEntry]) -> Iterator[HistoryEntry]:
    """Yield the uncommitted changes, if there are any, and the first ``count`` commits."""
    for entry in entries:
        yield entry
        if entry.commit is not None and count is not None:
            count -= 1
            if count == 0:
                return


@output.subcommand(force=True)
@click.argument("args", nargs=-1, metavar="BASE OURS THEIRS")
@click.option("-o", "--out", type=NEW_FILE, help="Write to this file instead of the screen.")
@click.option("--resolve", "side", type=click.Choice(["ours", "theirs"]),
              help="Resolve conflicts in favor of one side: --resolve ours FILE [PATH]...")  # fmt: skip
@click.option("--git", "driver", is_flag=True, help="Act as git's merge driver: --git %O %A %B %L %P.")
def merge_command(
    args: tuple[str, ...], out: Path | None, side: Literal["ours", "theirs"] | None, driver: bool, force: bool,
    as_json: bool,
) -> int:  # fmt: skip
    """Merge two edited versions of a document semantically, or resolve the conflicts from an earlier merge.

    Edits to different values never conflict, even if they are on the same line. If both sides changed the same value
    differently, the merged document keeps our value and lists the conflict under `conflicts`. It cannot be compiled
    until the conflict is resolved: correct the value and remove the entry, or choose a side with --resolve, either for
    all conflicts or for the specified paths. The exit code is 1 if there are conflicts, or if the merged document has
    an error that neither side has.
    """
    if driver:
        return _drive_merge(args)
    if side is not None:
        return _resolve(side, args, out, force, as_json)
    if len(args) != 3:
        raise SimfoundryError("pass three files: the common base, ours and theirs")
    from simfoundry.spec.change.merge.conflict import dotted
    from simfoundry.spec.change.merge.texts import merge_texts, new_errors

    files = [Path(file) for file in args]
    texts = [_text(path) for path in files]
    merged = merge_texts(*texts)
    changed = out or files[1]
    errors = new_errors(changed, merged.text, *texts[1:])
    if out is not None:
        output.protect_output(out, files, force, merged.text)
        output.write_in_place(out, merged.text)
    if as_json:
        conflicts = [{"path": dotted(c.path), **c.record()} for c in merged.conflicts]
        findings = [d.to_json() for d in errors]
        output.print_json({"out": out and str(out), "conflicts": conflicts, "findings": findings, "text": merged.text})
    elif out is None:
        output.print_document(merged.text)
    else:
        click.echo(f"wrote {out}: {output.plural(len(merged.conflicts), 'conflict')}")
    return _report_merge(merged, errors, changed, as_json)


def _drive_merge(args: Sequence[str]) -> int:
    """Merge into the second file in place, as git expects. Files that are not documents are merged line by line."""
    if len(args) != 5:
        raise SimfoundryError(f"git must pass 5 arguments, not {len(args)}; run `simfoundry git install` again")
    base, ours, theirs = map(Path, args[:3])
    name = args[4]
    try:
        from simfoundry.spec.change.merge.texts import merge_texts, new_errors

        texts = [path.read_bytes().decode("utf-8") for path in (base, ours, theirs)]
        merged = merge_texts(*texts)
        errors = new_errors(Path(name), merged.text, *texts[1:])
        output.write_in_place(ours, merged.text)
    except Exception as error:  # on any failure, fall back to what git alone would have done
        reason = str(error) or type(error).__name__
        click.echo(printable(f"{name}: merged line by line, because {reason}"), err=True)
        return _by_lines(args)
    if merged.conflicts or errors:
        click.echo(printable(f"{name}: {output.plural(len(merged.conflicts), 'conflict')}"), err=True)
    return _report_merge(merged, errors, Path(name))


def _by_lines(args: Sequence[str]) -> int:
    """Merge three files line by line into the second one, using git."""
    base, ours, theirs, size, _ = args
    labels = [word for name in ("ours", "base", "theirs") for word in ("-L", name)]
    size_option = [f"--marker-size={size}"] if size.isdigit() and int(size) > 0 else []
    done = subprocess.run(["git", "merge-file", *labels, *size_option, "--", ours, base, theirs], check=False)
    return output.FINDINGS if done.returncode else output.DONE


def _resolve(side: Literal["ours", "theirs"], args: Sequence[str], out: Path | None, force: bool, as_json: bool) -> int:
    from simfoundry.spec.change.merge.texts import resolve
    from simfoundry.spec.load import load
    from simfoundry.spec.models.kinds import KINDS, model_of
    from simfoundry.spec.yaml.nodes import YamlError
    from simfoundry.spec.yaml.text import read
    from simfoundry.spec.yaml.tree import read_tree
    from simfoundry.spec.yaml.write import write_tree

    if not args:
        raise SimfoundryError("pass the file with the conflicts: simfoundry merge --resolve ours FILE [PATH]...")
    file = Path(args[0])
    try:
        document = read(file)
    except YamlError as error:
        raise SpecError([error.diagnostic(str(file))]) from None
    kind = document.data.get("simfoundry") if isinstance(document.data, dict) else None
    model = model_of(kind) if kind in KINDS else None
    tree, decided = resolve(read_tree(document), model, side, args[1:])
    text = write_tree(tree, model)
    if out is not None and out.resolve() != file.resolve():  # resolving in place may overwrite the file
        output.protect_output(out, force=force, text=text)
    output.write_in_place(out or file, text)
    findings = load(out or file).all_findings()
    if as_json:
        facts = {"out": str(out or file), "decided": decided, "left": list(tree.data.get("conflicts", {}))}
        output.print_json(facts | {"findings": [d.to_json() for d in findings]})
    else:
        for key in decided:
            click.echo(printable(f"{key}: took {side}"))
        output.print_findings(findings)
    return output.FINDINGS if any(d.severity == "error" for d in findings) else output.DONE


def _text(path: Path) -> str:
    try:
        return path.read_bytes().decode("utf-8")
    except UnicodeDecodeError:
        raise SimfoundryError(f"{path} could not be decoded as UTF-8") from None


def _report_merge(merged: MergedText, errors: list[Diagnostic], name: Path, quiet: bool = False) -> int:
    """Print the conflicts, the errors and the next step unless ``quiet`` is set, and return the exit code."""
    if not quiet:
        for conflict in merged.conflicts:
            click.echo(printable(str(conflict)), err=True)
        if errors:
            click.echo(render(errors, texts={str(name): merged.text}), err=True)
        if merged.conflicts:
            choose = f"or choose a side: simfoundry merge --resolve ours {name}"
            click.echo(printable(f"edit {name} and remove its `conflicts`, {choose}"), err=True)
    return output.FINDINGS if merged.conflicts or errors else output.DONE
