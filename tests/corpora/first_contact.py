"""What a newcomer does, as the README prints it: ``python -m tests.corpora.first_contact``.

Builds the wheel from a copy of the files that git knows, installs it into a fresh environment with the README's own
line, and runs the README's commands in an empty folder: no variables of the environment but a path that holds that
environment alone (so no git), and no network. Prints a table; exit code 1 where a command fails, or the demo takes
longer than promised. Needs a package index for the installation, and Linux with the right to cut off the network
(``unshare --net``).
"""

from __future__ import annotations

import argparse
import json
import os
import re
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from tests.conftest import REPOSITORY

README = REPOSITORY / "README.md"
HEADING = "## Install from a wheel"
MAX_DEMO_S = 20.0
"""CPU time that the demo may take [s]: the wall clock of a machine that does nothing else is a little less."""

OFFLINE = ("unshare", "--net")


@dataclass(frozen=True)
class Step:
    """A command that was run: its exit code, CPU time and wall time [s], and what it printed."""

    command: str
    code: int
    cpu: float
    wall: float
    printed: str


def main(arguments: list[str] | None = None) -> int:
    """Install, run, print the table; 1 where something failed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--python", default=sys.executable, help="the Python of the fresh environment")
    parser.add_argument("--keep", type=Path, help="work in this folder, and leave it")
    options = parser.parse_args(arguments)
    if subprocess.run([*OFFLINE, "true"], capture_output=True, check=False).returncode != 0:
        print("not run: the network cannot be cut off here, as `unshare --net` is not permitted; run as root on Linux")
        return 0
    with tempfile.TemporaryDirectory(prefix="simfoundry-first-") as temporary:
        work = (options.keep or Path(temporary)).resolve()
        work.mkdir(parents=True, exist_ok=True)
        steps = [*install(work, options.python)]
        steps += walk(work) if all(step.code == 0 for step in steps) else []
        troubles = [*_troubles(steps), *(_missing(work) if all(step.code == 0 for step in steps) else [])]
    for step in steps:
        print(f"{'ok  ' if step.code == 0 else 'FAIL'} {step.cpu:7.1f} s CPU {step.wall:7.1f} s  {step.command}")
    for trouble in troubles:
        print(trouble)
    return int(bool(troubles))


def blocks() -> tuple[list[str], list[str]]:
    """The README's commands, without their comments: those that install, and those of an empty folder."""
    _, _, section = README.read_text(encoding="utf-8").partition(HEADING)
    found = re.findall(r"^```sh\n(.*?)^```", section.partition("\n## ")[0], re.DOTALL | re.MULTILINE)
    first, second = ([re.sub(r"\s+#.*", "", line) for line in block.splitlines()] for block in found[:2])
    return first, second


def install(work: Path, python: str) -> Iterator[Step]:
    """Run the README's installation in a copy of the repository's files, in a fresh environment."""
    copy, venv = work / "copy", work / "venv"
    _copy_tracked(copy)
    subprocess.run([python, "-m", "venv", str(venv)], check=True)
    for command in blocks()[0]:
        path = f"{venv / 'bin'}:/usr/local/bin:/usr/bin:/bin"
        step = _run(command, copy, {"PATH": path, "HOME": str(_home(work)), **_index()}, ())
        yield step
        if step.code != 0:
            return


def walk(work: Path) -> Iterator[Step]:
    """Run the README's commands in an empty folder: only the environment's own programs, and no network."""
    folder = work / "empty"
    folder.mkdir()
    variables = {"PATH": str(work / "venv" / "bin"), "HOME": str(_home(work))}
    assert shutil.which("git", path=variables["PATH"]) is None
    for command in blocks()[1]:
        yield _run(command, folder, variables, OFFLINE)


def _copy_tracked(target: Path) -> None:
    """The files that git knows, and new ones that it does not ignore: a fresh clone of what is here."""
    listed = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "-z"]
    names = subprocess.run(listed, cwd=REPOSITORY, capture_output=True, check=True).stdout.decode().split("\0")
    for name in filter(None, names):
        if (REPOSITORY / name).is_file():
            (target / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(REPOSITORY / name, target / name)


def _index() -> dict[str, str]:
    """Where pip looks for packages on this machine, and how it is reached: configuration, not part of the proof."""
    return {k: v for k, v in os.environ.items() if k.startswith("PIP_") or k.lower().endswith("_proxy")}


def _home(work: Path) -> Path:
    home = work / "home"
    home.mkdir(exist_ok=True)
    return home


def _run(command: str, folder: Path, variables: dict[str, str], before: tuple[str, ...]) -> Step:
    """Run a line of a shell with these variables of the environment and no others."""
    line = [*before, "/usr/bin/env", "-i", *(f"{k}={v}" for k, v in variables.items()), "/bin/sh", "-c", command]
    begun, spent = time.monotonic(), _cpu()
    done = subprocess.run(line, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
    step = Step(command, done.returncode, _cpu() - spent, time.monotonic() - begun, done.stdout)
    print(f"$ {command}\n{done.stdout}")
    return step


def _cpu() -> float:
    """CPU time of all children that have ended [s]."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _troubles(steps: list[Step]) -> Iterator[str]:
    for step in steps:
        if step.code != 0:
            yield f"`{step.command}` ended with {step.code}"
        if "Traceback" in step.printed:
            yield f"`{step.command}` shows a traceback"
        if step.command.startswith("simfoundry demo") and step.cpu > MAX_DEMO_S:
            yield f"`{step.command}` takes {step.cpu:.1f} s of CPU time, and may take {MAX_DEMO_S:g} s"


def _missing(work: Path) -> Iterator[str]:
    """What the commands should have come to."""
    folder = work / "empty"
    report = json.loads((folder / "build" / "demo" / "arm" / "report.json").read_text())
    if not report["success"]:
        yield f"the arm of the demo failed: {report['reason']}"
    for name in ("build/demo/arm/strip.png", "build/worlds/usd/scene.usda", "build/eval/report.html"):
        if not (folder / name).is_file():
            yield f"there is no {name}"
    for score in json.loads((folder / "build" / "eval" / "results.json").read_text())["scores"]:
        if score["successes"] < score["rollouts"]:
            yield f"the expert wins {score['successes']} of {score['rollouts']} rollouts of {score['task']}"


if __name__ == "__main__":
    sys.exit(main())
