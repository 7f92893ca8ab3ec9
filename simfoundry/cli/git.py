"""``simfoundry git``."""

from __future__ import annotations

import os
import re
import shlex
import sys
from dataclasses import dataclass
from pathlib import Path

import click

from simfoundry.cli.output import DONE, FINDINGS, CannotError, json_option, print_json, reporting
from simfoundry.spec.change.git.revisions import GitError, git
from simfoundry.spec.models.kinds import KINDS, suffix

DRIVER = "simfoundry"
PATTERNS = (*(f"*{suffix(kind)}" for kind in KINDS), "capture.yaml")
"""File patterns of documents."""
LINES = tuple(f"{pattern} diff={DRIVER} merge={DRIVER}" for pattern in PATTERNS)

_scope = (
    click.option("--global", "everywhere", is_flag=True, help="Apply to all your repositories."),
    click.option("--local", "here", is_flag=True, help="Apply to this repository only (default)."),
)


@dataclass(frozen=True)
class Scope:
    """Scope of the git settings: one repository, or all repositories of the user."""

    option: str
    attributes: Path

    @property
    def words(self) -> str:
        """Describe the scope for messages."""
        return "for all your repositories" if self.option == "--global" else "in this repository"


@click.group()
def git_command() -> None:
    """Set up git to diff and merge documents by meaning."""


@git_command.command()
@_scope[0]
@_scope[1]
@click.option("--uninstall", is_flag=True, help="Remove the settings.")
@reporting
def install(everywhere: bool, here: bool, uninstall: bool) -> int:
    """Register simfoundry as git's diff and merge driver for documents.

    The settings go into git's own configuration, which is not shared, and the file patterns into `.gitattributes`,
    which is shared: commit it. On machines without the settings, git treats documents as text, as usual.
    """
    scope = _scoped(everywhere, here)
    undo = f"simfoundry git install{' --global' if everywhere else ''} --uninstall"
    if uninstall:
        for section in (f"diff.{DRIVER}", f"merge.{DRIVER}"):
            if _settings(scope, section):
                git(Path(), "config", scope.option, "--remove-section", section)
                click.echo(f"removed {section} {scope.words}")
        if _remove_lines(scope.attributes):
            click.echo(f"removed the patterns from {scope.attributes}")
        return DONE
    for key, value in settings().items():
        git(Path(), "config", scope.option, "--replace-all", key, value)
        click.echo(f"set {key}")
    added = _add_lines(scope.attributes)
    click.echo(f"{'added the patterns to' if added else 'the patterns are in'} {scope.attributes}")
    click.echo(f"done {scope.words}; to undo: {undo}")
    if not everywhere:
        click.echo("commit .gitattributes; every member of the team must run `simfoundry git install` once")
    return DONE


@git_command.command()
@json_option
@reporting
def status(as_json: bool) -> int:
    """Show the settings for this repository and for all. The exit code is 1 if a setting is missing."""
    wanted = settings()
    found = {key: _output("config", "--get", key) for key in wanted}
    folder = _top()
    given = _output("check-attr", "diff", "merge", "--", f"a{PATTERNS[0][1:]}") if folder is not None else ""
    attributes = [line.rpartition(": ")[2] for line in given.splitlines()] == [DRIVER, DRIVER]
    if as_json:
        print_json({"settings": found, "attributes": attributes, "complete": all(found.values()) and attributes})
    else:
        for key, value in found.items():
            other = (
                "" if not value or value == wanted[key] else "  (from another installation; run install to update it)"
            )
            click.echo(f"{key} = {value}{other}" if value else f"{key} is not set")
        if folder is None:
            click.echo("this is not a git repository, so it has no attributes")
        else:
            click.echo(f"documents {'have' if attributes else 'do not have'} the attributes diff and merge here")
        if not (all(found.values()) and attributes):
            click.echo("to add the missing settings: simfoundry git install")
    return DONE if all(found.values()) and attributes else FINDINGS


def settings() -> dict[str, str]:
    """Return the settings by key. They name this Python, so that they work without an active environment.

    -P keeps Python from importing modules of the repository in which git runs. If this Python, or simfoundry in it, no
    longer exists, documents are merged as text.
    """
    python = shlex.quote(Path(sys.executable).as_posix())
    ours = f"{python} -P -m simfoundry.cli.main"
    there = f"{python} -P -c 'import simfoundry' 2>/dev/null"
    by_meaning, asked = (text.replace("%", "%%") for text in (f"{ours} merge --git --", there))
    by_lines = "git merge-file -L ours -L base -L theirs --marker-size=%L %A %O %B"
    return {
        f"diff.{DRIVER}.command": f"{ours} diff --git",
        f"merge.{DRIVER}.name": "documents of SimFoundry, merged by meaning",
        f"merge.{DRIVER}.driver": f"if {asked}; then {by_meaning} %O %A %B %L %P; else {by_lines}; fi",
    }


def _scoped(everywhere: bool, here: bool) -> Scope:
    if everywhere and here:
        raise CannotError("--global and --local are mutually exclusive")
    if everywhere:
        named = _output("config", "--global", "--type=path", "--get", "core.attributesFile")
        config = Path(os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config")
        return Scope("--global", Path(named) if named else config / "git" / "attributes")
    top = _top()
    if top is None:
        raise CannotError("this is not a git repository; create one with `git init`, or pass --global")
    return Scope("--local", top / ".gitattributes")


def _top() -> Path | None:
    """Return the top folder of the current repository; None if there is none, or if it has no working tree."""
    found = _output("rev-parse", "--show-toplevel")
    return Path(found) if found else None


def _settings(scope: Scope, section: str) -> str:
    return _output("config", scope.option, "--get-regexp", rf"^{re.escape(section)}\.")


def _add_lines(file: Path) -> bool:
    """Add the missing patterns; keep all other lines."""
    text = _read(file)
    missing = [line for line in LINES if line not in text.splitlines()]
    if missing:
        start = text if not text or text.endswith("\n") else f"{text}\n"
        _write(file, start + "".join(f"{line}\n" for line in missing))
    return bool(missing)


def _remove_lines(file: Path) -> bool:
    """Remove the patterns, and the file if it contains nothing else."""
    text = _read(file)
    kept = [line for line in text.splitlines(keepends=True) if line.rstrip("\r\n") not in LINES]
    if len(kept) == len(text.splitlines()):
        return False
    if kept:
        _write(file, "".join(kept))
    else:
        file.unlink()
    return True


def _read(file: Path) -> str:
    return file.read_bytes().decode("utf-8", "surrogateescape") if file.exists() else ""


def _write(file: Path, text: str) -> None:
    from simfoundry.runtime.files import write_atomically

    write_atomically(file.resolve(), text.encode("utf-8", "surrogateescape"))


def _output(*args: str) -> str:
    """Return the output of git, empty if it fails."""
    try:
        return os.fsdecode(git(Path(), *args)).strip()
    except GitError as error:
        if "not installed" in str(error):
            raise
        return ""
