"""Kills: ``python -m tests.corpora.kills [COMMAND ...] [--kills N]``.

Each command that writes is ended by kill -9 at N moments (84 by default), half of them spread over the whole run, half
from when it starts to write. After each kill no file may be torn or lost: every input is as it was, and every output is
as it was before or as an undisturbed run leaves it; `compile` and `capture` replace their folder as a whole. Then the
same command runs again and must leave exactly what an undisturbed run leaves, and `eval`, `cousins`, `record` and
`augment` must keep every rollout, cousin and attempt that they had finished.

Prints a line for each command; exit code 1 if anything was torn or lost.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import textwrap
import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml

from simfoundry.data.shards import read_shard
from tests.cli.command import MAIN
from tests.conftest import REPOSITORY
from tests.data.conftest import POLICY
from tests.evaluate.benches import write_bench

KILLS, SEED = 84, 2026

Tree = Mapping[str, bytes]
"""The bytes of each file, by path; without what a killed run may leave behind: hidden files in hidden folders."""

SCENE = """\
simfoundry: scene/1
name: killed
materials: {{wood: {{density: 500, friction: 0.6}}}}
objects:
  desk: {{fixed: true, shape: {{box: [1.4, 0.7, 0.04]}}, material: wood, pose: {{xyz: [0.45, 0, -0.02]}}}}
  cup: {{shape: {{cylinder: {{radius: 0.04, height: {height}}}}}, material: wood, pose: {{xyz: [0.4, {y}, 0.05]}}}}
  ball: {{shape: {{sphere: 0.03}}, material: wood, pose: {{xyz: [0.4, -0.2, {z}]}}}}
"""


@dataclass(frozen=True)
class Case:
    """A command, the project that it runs in, and what it promises.

    ``whole`` is the folder that is replaced as a whole, if any. ``growing`` matches the files that grow during the run
    or exist only then, ``clocks`` matches the times on a clock, which no two runs share, and ``kept`` matches the files
    that the next run must not write again. ``done`` returns the numbers of the jobs that a killed run has finished, and
    the next run must not add them to the log ``started``. ``before`` is Python code that runs before the command.
    """

    name: str
    arguments: tuple[str, ...]
    prepare: Callable[[Path], None]
    whole: str = ""
    growing: tuple[str, ...] = ()
    clocks: str = ""
    kept: str = r"(?!)"
    done: Callable[[Path], set[int]] = lambda root: set()
    started: str = ""
    before: str = ""


def scene(height: float = 0.1, y: float = 0.1, z: float = 0.05) -> str:
    """A scene document with three numbers to edit [m]."""
    return SCENE.format(height=height, y=y, z=z)


def built(root: Path) -> None:
    """A scene that was compiled, and edited since."""
    (root / "a.scene.yaml").write_text(scene(0.1))
    subprocess.run([sys.executable, "-c", MAIN, "compile", "a.scene.yaml"], cwd=root, check=True, capture_output=True)
    (root / "a.scene.yaml").write_text(scene(0.12))


def specs(root: Path) -> None:
    """The shipped documents."""
    shutil.copytree(REPOSITORY / "specs", root, dirs_exist_ok=True, ignore=shutil.ignore_patterns("*.py", "results"))


def starter(root: Path) -> None:
    """The task that `new` writes, whose arm comes with the package."""
    for kind, name in (("scene", "desk"), ("task", "lift")):
        subprocess.run([sys.executable, "-c", MAIN, "new", kind, name], cwd=root, check=True, capture_output=True)


def unformatted(root: Path) -> None:
    """The shipped documents as a library without comments and layout would write them."""
    specs(root)
    for file in sorted(root.rglob("*.yaml")):
        file.write_text(yaml.safe_dump(yaml.safe_load(file.read_text()), sort_keys=True, default_flow_style=False))


def versions(root: Path) -> None:
    """Three versions of a scene, as git hands them to its merge driver."""
    for name, text in (("base", scene()), ("ours", scene(y=0.2)), ("theirs", scene(z=0.3))):
        (root / name).write_text(text)


LOGGED = """
    def reset(self, instruction, seed, push=Push.reset):
        with open("started.log", "a") as log:
            log.write(f"{seed}\\n")
        push(self, instruction, seed)

    Push.reset = reset
"""


def pushes(root: Path) -> None:
    """A task for an arm, and a policy that fails from some initial states and notes where it starts."""
    write_bench(root)
    (root / "pushing.py").write_text(POLICY + textwrap.dedent(LOGGED))
    (root / "started.log").write_text("")


LOGGED_SEGMENTS = """
from simfoundry.augment.policy import AugmentPolicy

def reset(self, instruction, seed, plain=AugmentPolicy.reset):
    if seed >= 1000:
        with open("started.log", "a") as log:
            log.write(f"{seed - 1000}\\n")
    plain(self, instruction, seed)

AugmentPolicy.reset = reset
"""


def demonstrations(root: Path) -> None:
    """Demonstrations of a task for an arm without a gripper, and a log of where their augmentation starts."""
    write_bench(root)
    (root / "pushing.py").write_text(POLICY)
    command = ("record", "push.task.yaml", "-p", "python:pushing.py:Push", "-n", "2", "-o", "demos")
    subprocess.run([sys.executable, "-c", MAIN, *command], cwd=root, check=True, capture_output=True)
    (root / "started.log").write_text("")


def attempts(root: Path) -> set[int]:
    """The attempts that a recording has finished."""
    return {attempt.index for path in root.glob("out/*/*.npz") for attempt in read_shard(path)}


CASES = (
    Case("compile", ("compile", "a.scene.yaml"), built, whole="build"),
    Case("capture", ("capture", "captures/desk", "-o", "out"), specs, whole="out"),
    Case("fmt", ("fmt", "."), unformatted),
    Case("merge", ("merge", "--git", "base", "ours", "theirs", "7", "a.scene.yaml"), versions),
    Case(
        "cousins",
        ("cousins", "cousins/other_cups.cousins.yaml", "-n", "4", "--no-gallery", "-j", "1", "-o", "out"),
        specs,
        growing=("out/.cousins/log.jsonl", "out/.cousins/run.json", "out/manifest.json"),
        kept=r"out/\d+\.(scene|task)\.yaml",
    ),
    Case(
        "eval",
        ("eval", "lift.task.yaml", "-p", "random", "-n", "4", "--no-video", "-o", "out"),
        starter,
        growing=("out/results.json", "out/report.html"),
        clocks=r'"(total|physics|render|policy|judge)": [0-9.]+',
        kept=r"out/rollouts/.*\.json",
    ),
    Case(
        "record",
        ("record", "push.task.yaml", "-p", "python:pushing.py:Push?miss=3", "-n", "4", "-j", "2", "-o", "out"),
        pushes,
        growing=(r"out/unfinished/\d+\.npz",),
        done=attempts,
        started="started.log",
    ),
    Case(
        "augment",
        ("augment", "demos", "-n", "4", "-o", "out"),
        demonstrations,
        growing=(r"out/unfinished/\d+\.npz",),
        done=attempts,
        started="started.log",
        before=LOGGED_SEGMENTS,
    ),
)


@dataclass
class Run:
    """A case in a folder of its own."""

    case: Case
    folder: Path

    def __post_init__(self) -> None:
        self.pristine, self.root = self.folder / "pristine", self.folder / "root"
        self.environment = {
            **os.environ,
            "PYTHONPATH": str(REPOSITORY),
            "SIMFOUNDRY_CACHE": str(self.folder / "cache"),
        }
        self.pristine.mkdir(parents=True)
        (self.pristine / "simfoundry.yaml").write_text("")
        self.case.prepare(self.pristine)
        self.before = self.tree(self.pristine)
        self.reset()
        self.start().wait()  # fills the cache
        self.reset()
        started = time.perf_counter()
        process = self.start()
        self.wait_for_change(process)
        writes = time.perf_counter()
        process.wait()
        self.seconds, self.writing = time.perf_counter() - started, time.perf_counter() - writes
        self.after = self.tree(self.root)
        assert self.after != self.before
        assert not self.case.started or (self.root / self.case.started).read_text()

    def reset(self) -> None:
        shutil.rmtree(self.root, ignore_errors=True)
        shutil.copytree(self.pristine, self.root)

    def start(self) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-c", self.case.before + MAIN, *self.case.arguments]
        quiet = subprocess.DEVNULL
        return subprocess.Popen(
            command, cwd=self.root, env=self.environment, stdout=quiet, stderr=quiet, start_new_session=True
        )

    def wait_for_change(self, process: subprocess.Popen[bytes]) -> None:
        """Return as soon as any folder of the project has changed, or the process has ended."""
        before = self._stamps()
        while process.poll() is None and self._stamps() == before:
            time.sleep(0.0002)

    def _stamps(self) -> list[int]:
        return [Path(folder).stat().st_mtime_ns for folder, _, _ in os.walk(self.root)]

    def tree(self, root: Path) -> Tree:
        found = {}
        for file in sorted(root.rglob("*")):
            name = file.relative_to(root).as_posix()
            hidden = any(part.startswith(".") for part in Path(name).parts)
            if file.is_file() and name != self.case.started and (self._is_growing(name) or not hidden):
                found[name] = (
                    re.sub(self.case.clocks.encode(), b"", file.read_bytes())
                    if self.case.clocks
                    else (file.read_bytes())
                )
        return found

    def kill(self, delay: float, at_writing: bool) -> None:
        """End the command ``delay`` seconds [s] after its start, or after it has started to write."""
        process = self.start()
        if at_writing:
            self.wait_for_change(process)
        time.sleep(delay)
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()

    def problems(self) -> list[str]:
        """What a killed run has torn or lost."""
        found, whole = self.tree(self.root), self.case.whole
        out = [f"{name} is lost" for name in self.before if name not in found]
        for name, content in found.items():
            if content not in (self.before.get(name), self.after.get(name)) and not self._grows(name, content):
                out.append(f"{name} is torn")
        if whole:
            parts = [
                {n: c for n, c in tree.items() if n.startswith(f"{whole}/")}
                for tree in (found, self.before, self.after)
            ]
            if parts[0] not in parts[1:]:
                out.append(f"{whole} is neither the old nor the new one")
        return out

    def _is_growing(self, name: str) -> bool:
        return any(re.fullmatch(pattern, name) for pattern in self.case.growing)

    def _grows(self, name: str, content: bytes) -> bool:
        if not self._is_growing(name):
            return False
        if name.endswith(".npz"):
            return bool(read_shard(self.root / name))  # raises if the file is torn
        try:
            *lines, last = content.decode().split("\n") if name.endswith(".jsonl") else (content.decode(), "")
            for line in lines:
                if name.endswith((".json", ".jsonl")):
                    json.loads(line)
        except ValueError:
            return False
        return last == "" or name.endswith(".jsonl")  # an unfinished last line is dropped by the next run

    def repeat(self) -> list[str]:
        """Run the command again; return what differs from an undisturbed run, and what was made twice."""
        names = [name for name in self.tree(self.root) if re.fullmatch(self.case.kept, name)]
        kept = {name: (self.root / name).stat().st_mtime_ns for name in names}
        done = self.case.done(self.root)
        if self.case.started:
            (self.root / self.case.started).write_text("")
        self.start().wait()
        now = self.tree(self.root)
        out = [f"{n} differs after the next run" for n in {*now, *self.after} if now.get(n) != self.after.get(n)]
        out += [f"{name} was made again" for name, t in kept.items() if (self.root / name).stat().st_mtime_ns != t]
        if self.case.started:
            again = done & set(map(int, (self.root / self.case.started).read_text().split()))
            out += [f"job {job} ran again" for job in sorted(again)]
        if self.case.whole:
            left = [p.name for p in (self.root / self.case.whole).iterdir() if p.name.startswith(".build.")]
            out += [f"{name} is left" for name in left]
        return out


def kills(case: Case, folder: Path, count: int) -> int:
    """Kill a command ``count`` times; return how many kills tore or lost something."""
    run, rng = Run(case, folder), np.random.default_rng(SEED)
    states: Counter[str] = Counter()
    missed = 0
    for k in range(count):
        run.reset()
        at_writing = bool(k % 2)
        run.kill(float(rng.uniform(0, run.writing if at_writing else 1.1 * run.seconds)), at_writing)
        found = run.tree(run.root)
        states["before" if found == run.before else "after" if found == run.after else "between"] += 1
        said = run.problems() + run.repeat()
        for text in said[:5]:
            print(f"  {case.name} {k}: {text}", flush=True)
        missed += bool(said)
    print(
        f"{case.name:<8} {count} kills in runs of {run.seconds:.2f} s, {1000 * run.writing:.0f} ms of it after the "
        f"first write: {states['before']} left the state before, {states['after']} the finished one, "
        f"{states['between']} one between; "
        f"{missed} torn or lost",
        flush=True,
    )
    return missed


def main() -> int:
    """Kill the commands that are asked for; 1 if anything was torn or lost."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("commands", nargs="*", metavar="COMMAND", help=", ".join(case.name for case in CASES))
    parser.add_argument("--kills", type=int, default=KILLS)
    given = parser.parse_args()
    missed = 0
    for case in CASES:
        if not given.commands or case.name in given.commands:
            with tempfile.TemporaryDirectory(prefix="simfoundry-kills-") as folder:
                missed += kills(case, Path(folder), given.kills)
    return int(missed > 0)


if __name__ == "__main__":
    sys.exit(main())
