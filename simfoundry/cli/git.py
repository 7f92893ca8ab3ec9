"""The command ``simfoundry git``."""

from __future__ import annotations

import os
import re
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path

import click

from simfoundry.cli import output
from simfoundry.errors import SimfoundryError
from simfoundry.spec.change.git.revisions import GitError, git
from simfoundry.spec.models.kinds import KINDS, suffix

DRIVER = "simfoundry"
# File patterns that match documents.
PATTERNS = (*(f"*{suffix(kind)}" for kind in KINDS), "capture.yaml")
LINES = tuple(f"{pattern} diff={DRIVER} merge={DRIVER}" for pattern in PATTERNS)


@click.group()
def git_command() -> None:
    """Set up semantic diffs and merges of documents in git."""


@git_command.command()
@click.option("--global", "everywhere", is_flag=True, help="Apply to all your repositories.")
@click.option("--local", "here", is_flag=True, help="Apply to this repository only (default).")
@click.option("--uninstall", is_flag=True, help="Remove the settings.")
@output.reporting
def install(everywhere: bool, here: bool, uninstall: bool) -> int:
    """Register simfoundry as git's diff and merge driver for documents.

    The settings are written to git's own configuration, which is not shared. The file patterns are written to
    `.gitattributes`, which is shared and should be committed. On machines without these settings, git treats documents
    as text, as usual.
    """
    attributes = _attributes_file(everywhere, here)
    scope, words = ("--global", "for all your repositories") if everywhere else ("--local", "in this repository")
    if uninstall:
        for section in (f"diff.{DRIVER}", f"merge.{DRIVER}"):
            if _output("config", scope, "--get-regexp", rf"^{re.escape(section)}\."):
                git(Path(), "config", scope, "--remove-section", section)
                click.echo(f"removed {section} {words}")
        if _set_patterns(attributes, ()):
            click.echo(f"removed the patterns from {attributes}")
        return output.DONE
    for key, value in settings().items():
        git(Path(), "config", scope, "--replace-all", key, value)
        click.echo(f"set {key}")
    added = _set_patterns(attributes, LINES)
    click.echo(f"{'added the patterns to' if added else 'the patterns are already in'} {attributes}")
    click.echo(f"done {words}; to undo: simfoundry git install{' --global' if everywhere else ''} --uninstall")
    if not everywhere:
        click.echo("commit .gitattributes; each team member must run `simfoundry git install` once")
    return output.DONE


@git_command.command()
@output.json_option
@output.reporting
def status(as_json: bool) -> int:
    """Show the git settings that apply to this repository. The exit code is 1 if a setting is missing."""
    wanted = settings()
    found = {key: _output("config", "--get", key) for key in wanted}
    folder = _top()
    given = _output("check-attr", "diff", "merge", "--", f"a{PATTERNS[0][1:]}") if folder is not None else ""
    attributes = [line.rpartition(": ")[2] for line in given.splitlines()] == [DRIVER, DRIVER]
    complete = all(found.values()) and attributes
    if as_json:
        output.print_json({"settings": found, "attributes": attributes, "complete": complete})
    else:
        for key, value in found.items():
            other = "" if value == wanted[key] else "  (from another installation; run install to update it)"
            click.echo(f"{key} = {value}{other}" if value else f"{key} is not set")
        have = "have" if attributes else "do not have"
        text = f"documents in this repository {have} the attributes diff and merge"
        click.echo("this is not a git repository, so there are no attributes" if folder is None else text)
        if not complete:
            click.echo("to add the missing settings: simfoundry git install")
    return output.DONE if complete else output.FINDINGS


def settings() -> dict[str, str]:
    """Return the git settings by key.

    The settings contain the path of the current Python interpreter, so they work without an active environment. The
    option -P prevents Python from importing modules from the repository in which git runs. If the interpreter or its
    simfoundry installation no longer exists, documents are merged as text.
    """
    python = shlex.quote(Path(sys.executable).as_posix())
    ours = f"{python} -P -m simfoundry.cli.main"
    there = f"{python} -P -c 'import simfoundry' 2>/dev/null"
    by_meaning, asked = (text.replace("%", "%%") for text in (f"{ours} merge --git --", there))
    by_lines = "git merge-file -L ours -L base -L theirs --marker-size=%L %A %O %B"
    return {
        f"diff.{DRIVER}.command": f"{ours} diff --git",
        f"merge.{DRIVER}.name": "semantic merge of SimFoundry documents",
        f"merge.{DRIVER}.driver": f"if {asked}; then {by_meaning} %O %A %B %L %P; else {by_lines}; fi",
    }


def _attributes_file(everywhere: bool, here: bool) -> Path:
    """Return the attributes file of the current repository, or of all repositories of the user."""
    if everywhere and here:
        raise SimfoundryError("--global and --local are mutually exclusive")
    if everywhere:
        named = _output("config", "--global", "--type=path", "--get", "core.attributesFile")
        config = Path(os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config")
        return Path(named) if named else config / "git" / "attributes"
    top = _top()
    if top is None:
        raise SimfoundryError("this is not a git repository; create one with `git init`, or pass --global")
    return top / ".gitattributes"


def _top() -> Path | None:
    """Return the top folder of the current repository, or None outside a repository with a working tree."""
    found = _output("rev-parse", "--show-toplevel")
    return Path(found) if found else None


def _set_patterns(file: Path, patterns: Sequence[str]) -> bool:
    """Add the missing ``patterns`` to a file, remove the rest of :data:`LINES`, and return True if the file changed.

    All other lines are kept. If the file would be empty, it is deleted.
    """
    from simfoundry.runtime.files import write_in_place

    before = file.read_bytes().decode("utf-8", "surrogateescape") if file.exists() else ""
    unwanted = set(LINES) - set(patterns)
    lines = [line for line in before.splitlines(keepends=True) if line.rstrip("\r\n") not in unwanted]
    if missing := [f"{line}\n" for line in patterns if line not in before.splitlines()]:
        lines = ["".join(lines), "" if not lines or lines[-1].endswith("\n") else "\n", *missing]
    after = "".join(lines)
    if after and after != before:
        write_in_place(file, after.encode("utf-8", "surrogateescape"))
    elif before and not after:
        file.unlink()
    return after != before


def _output(*args: str) -> str:
    """Return the output of a git command, or an empty string if the command fails."""
    try:
        return os.fsdecode(git(Path(), *args)).strip()
    except GitError as error:
        if "not installed" in str(error):
            raise
        return ""
