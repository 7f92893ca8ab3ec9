"""Call the command line as a shell would, in this process or in one of its own."""

from __future__ import annotations

import contextlib
import io
import json
import os
import pty
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest import mock

from simfoundry.cli.main import main
from tests.conftest import REPOSITORY


@dataclass(frozen=True)
class Done:
    """What a command left behind."""

    code: int
    out: str
    err: str

    @property
    def json(self) -> Any:
        """Standard output, which must be one JSON value and nothing else."""
        return json.loads(self.out)

    def one_line(self, *parts: str) -> str:
        """The only line on standard error that holds all parts."""
        lines = [line for line in self.err.splitlines() if all(p in line for p in parts)]
        assert len(lines) == 1, self.err
        return lines[0]


def run(*args: str | Path, together: bool = False) -> Done:
    """Run ``simfoundry`` with ``args`` in this process; an exception that it lets through fails the test.

    ``together`` gives all as output, in the order in which it is printed.
    """
    out = io.StringIO()
    err = out if together else io.StringIO()
    with (
        mock.patch.object(sys, "argv", ["simfoundry", *map(str, args)]),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
    ):
        try:
            main()
            code = 0
        except SystemExit as end:
            code = int(end.code or 0)
    return Done(code, out.getvalue(), "" if together else err.getvalue())


def python(code: str, *args: str | Path, **env: str) -> Done:
    """Run a Python program in a process of its own, this project importable and nothing a terminal."""
    done = subprocess.run(
        [sys.executable, "-c", code, *map(str, args)],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
        env={**os.environ, "PYTHONPATH": str(REPOSITORY), **env},
    )
    return Done(done.returncode, done.stdout, done.stderr)


SEVERAL = """
import contextlib, io, json, os, sys
from simfoundry.cli.main import main

left = []
for env, *args in json.loads(sys.argv[1]):
    os.environ.update(env)
    sys.argv = ['simfoundry', *args]
    out, err, code = io.StringIO(), io.StringIO(), 0
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            main()
        except SystemExit as end:
            code = int(end.code or 0)
    left.append((code, out.getvalue(), err.getvalue()))
print(json.dumps(left))
"""


def several(code: str, *calls: Sequence[str | Path], env: Sequence[Mapping[str, str]] = ()) -> list[Done]:
    """Run commands one after the other in one process, after some Python, each with more of the environment.

    To start Python and to import what a command needs takes longer than most commands.
    """
    environments = [*env, *[{} for _ in calls[len(env) :]]]
    told = [[dict(more), *map(str, call)] for call, more in zip(calls, environments, strict=True)]
    done = python(f"{code}\n{SEVERAL}", json.dumps(told))
    assert done.code == 0, done.err
    return [Done(*left) for left in done.json]


MAIN = "import sys; from simfoundry.cli.main import main; sys.argv[0] = 'simfoundry'; main()"

BLOCKED = """
import sys

class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.split('.')[0] in {names!r}:
            raise ModuleNotFoundError(f'No module named {{name!r}}', name=name)

sys.meta_path.insert(0, Absent())
"""


def absent(*names: str) -> str:
    """Python after which the packages ``names`` are not installed."""
    return BLOCKED.format(names=set(names))


def without(*names: str) -> str:
    """A program that is ``simfoundry`` where the packages ``names`` are not installed."""
    return absent(*names) + MAIN


def terminal(*args: str, **env: str) -> str:
    """What a command shows on a terminal of 80 columns, as it is sent there."""
    ours, theirs = pty.openpty()
    plain = {k: v for k, v in os.environ.items() if k not in ("NO_COLOR", "FORCE_COLOR", "CI")}
    process = subprocess.Popen(
        [sys.executable, "-c", MAIN, *args],
        stdin=theirs,
        stdout=theirs,
        stderr=theirs,
        env={**plain, "PYTHONPATH": str(REPOSITORY), "TERM": "xterm-256color", "COLUMNS": "80", **env},
    )
    os.close(theirs)
    shown = b""
    while True:
        try:
            part = os.read(ours, 65536)
        except OSError:  # Linux says so when the other end is closed
            break
        if not part:
            break
        shown += part
    os.close(ours)
    process.wait()
    return shown.decode().replace("\r\n", "\n")
