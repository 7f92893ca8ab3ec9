"""``simfoundry merge``."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click

from simfoundry.cli.options import NEW_FILE
from simfoundry.cli.output import (
    DONE,
    FINDINGS,
    CannotError,
    plural,
    print_document,
    print_findings,
    print_json,
    subcommand,
    write_in_place,
)
from simfoundry.spec.diagnostics import Diagnostic, printable, render

if TYPE_CHECKING:
    from simfoundry.spec.change.merge.texts import MergedText


@subcommand(force=True)
@click.argument("args", nargs=-1, metavar="BASE OURS THEIRS")
@click.option("-o", "--out", type=NEW_FILE, help="Write to this file instead of the screen.")
@click.option(
    "--resolve", "side", type=click.Choice(["ours", "theirs"]),
    help="Resolve conflicts in favor of one side: --resolve ours FILE [PATH]...",
)  # fmt: skip
@click.option("--git", "driver", is_flag=True, help="Act as git's merge driver: --git %O %A %B %L %P.")
def command(
    args: tuple[str, ...],
    out: Path | None,
    side: Literal["ours", "theirs"] | None,
    driver: bool,
    force: bool,
    as_json: bool,
) -> int:
    """Merge two edits of a document by meaning, or resolve the conflicts of an earlier merge.

    Edits of different values never conflict, regardless of their lines. If both sides changed one value differently,
    the document keeps ours, lists the value under `conflicts`, and cannot be compiled until the conflict is resolved:
    correct the value and remove the entry, or choose a side with --resolve, for all conflicts or for the given paths.
    The exit code is 1 if there is a conflict, or if the merged document has an error that neither side has.
    """
    if driver:
        return _driver(args)
    if side is not None:
        return _resolve(side, args, out, force, as_json)
    if len(args) != 3:
        raise CannotError("pass three files: the common base, ours and theirs")
    base, ours, theirs = map(Path, args)
    return _merge(base, ours, theirs, out, force, as_json)


def _merge(base: Path, ours: Path, theirs: Path, out: Path | None, force: bool, as_json: bool) -> int:
    from simfoundry.runtime.files import ensure_replaceable
    from simfoundry.spec.change.merge.texts import merge_texts, new_errors

    if out is not None:
        ensure_replaceable(out, (base, ours, theirs), force)

    texts = [_text(path) for path in (base, ours, theirs)]
    merged = merge_texts(*texts)
    errors = new_errors(out or ours, merged.text, *texts[1:])
    if out is not None:
        write_in_place(out, merged.text)
    if as_json:
        print_json({"out": str(out) if out else None, **_report(merged, errors), "text": merged.text})
    else:
        if out is None:
            print_document(merged.text)
        else:
            click.echo(f"wrote {out}: {plural(len(merged.conflicts), 'conflict')}")
        _print(merged, errors, out or ours)
    return FINDINGS if merged.conflicts or errors else DONE


def _driver(args: Sequence[str]) -> int:
    """Merge the second file in place, as git expects; files that are not documents are merged line by line."""
    if len(args) != 5:
        raise CannotError(
            f"git gives its merge driver 5 arguments, not {len(args)}; `simfoundry git install` sets it up"
        )
    base, ours, theirs = map(Path, args[:3])
    name = args[4]
    try:
        from simfoundry.spec.change.merge.texts import merge_texts, new_errors

        texts = [path.read_bytes().decode("utf-8") for path in (base, ours, theirs)]
        merged = merge_texts(*texts)
        errors = new_errors(Path(name), merged.text, *texts[1:])
        write_in_place(ours, merged.text)
    except Exception as error:  # on any failure, fall back to what git alone would have done
        reason = str(error) or type(error).__name__
        click.echo(printable(f"{name}: merged line by line, because {reason}"), err=True)
        return _by_lines(args)
    if merged.conflicts or errors:
        click.echo(printable(f"{name}: {plural(len(merged.conflicts), 'conflict')}"), err=True)
        _print(merged, errors, Path(name))
    return FINDINGS if merged.conflicts or errors else DONE


def _by_lines(args: Sequence[str]) -> int:
    """Merge three texts line by line with git, into the second; if that fails, ours stays and git keeps theirs."""
    base, ours, theirs, size, _ = args
    labels = [word for name in ("ours", "base", "theirs") for word in ("-L", name)]
    size_option = [f"--marker-size={size}"] if size.isdigit() and int(size) > 0 else []
    done = subprocess.run(["git", "merge-file", *labels, *size_option, "--", ours, base, theirs], check=False)
    return FINDINGS if done.returncode else DONE


def _resolve(side: Literal["ours", "theirs"], args: Sequence[str], out: Path | None, force: bool, as_json: bool) -> int:
    from simfoundry.runtime.files import ensure_replaceable
    from simfoundry.spec.change.merge.texts import resolve
    from simfoundry.spec.diagnostics import SpecError
    from simfoundry.spec.load import load
    from simfoundry.spec.models.kinds import KINDS, model_of
    from simfoundry.spec.yaml.nodes import YamlError
    from simfoundry.spec.yaml.text import read
    from simfoundry.spec.yaml.tree import read_tree
    from simfoundry.spec.yaml.write import write_tree

    if not args:
        raise CannotError("pass the file with the conflicts: simfoundry merge --resolve ours FILE [PATH]...")
    file = Path(args[0])
    if out is not None and out.resolve() != file.resolve():  # resolving in place may overwrite the file
        ensure_replaceable(out, force=force)
    try:
        document = read(file)
    except YamlError as error:
        raise SpecError([error.diagnostic(str(file))]) from None
    kind = document.data.get("simfoundry") if isinstance(document.data, dict) else None
    model = model_of(kind) if kind in KINDS else None
    tree, decided = resolve(read_tree(document), model, side, args[1:])
    text = write_tree(tree, model)
    write_in_place(out or file, text)
    findings = load(out or file).all_findings()
    if as_json:
        left = tree.data.get("conflicts", {})
        findings_ = [d.to_json() for d in findings]
        print_json({"out": str(out or file), "decided": decided, "left": list(left), "findings": findings_})
    else:
        for key in decided:
            click.echo(printable(f"{key}: took {side}"))
        print_findings(findings)
    return FINDINGS if any(d.severity == "error" for d in findings) else DONE


def _text(path: Path) -> str:
    try:
        return path.read_bytes().decode("utf-8")
    except UnicodeDecodeError:
        raise CannotError(f"{path} is not UTF-8 text") from None


def _print(merged: MergedText, errors: list[Diagnostic], name: Path) -> None:
    """Print each conflict on a line, the errors, and the next step."""
    for conflict in merged.conflicts:
        click.echo(printable(str(conflict)), err=True)
    if errors:
        click.echo(render(errors, texts={str(name): merged.text}), err=True)
    if merged.conflicts:
        click.echo(
            printable(
                f"edit {name} and remove its `conflicts`, or choose a side: simfoundry merge --resolve ours {name}"
            ),
            err=True,
        )


def _report(merged: MergedText, errors: list[Diagnostic]) -> dict[str, Any]:
    from simfoundry.spec.change.merge.conflict import dotted

    conflicts = [{"path": dotted(c.path), **c.record()} for c in merged.conflicts]
    return {"conflicts": conflicts, "findings": [d.to_json() for d in errors]}
