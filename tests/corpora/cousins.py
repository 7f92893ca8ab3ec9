"""Cousins by the hundred, held against what is promised: ``python -m tests.corpora.cousins [PART]... [-n N]``.

Parts, all by default:

``validity``    N cousins (100) of each recipe of ``specs/cousins`` that has layouts, read back from their files and let
                go for 2 s in MuJoCo and in PyBullet: what was asked for holds in 99%, nothing overlaps by more than
                1 mm or moves farther than 1 cm, and no task of a cousin is done already. ``-r`` names one recipe.
``kills``       a run that is killed (SIGKILL) at ten random moments and resumed gives the same bytes.
``workers``     so do 1 and 2 processes, and shards in any order.
``ray``         and so does Ray, started here.
``scale``       10,000 cousins in one run: the memory of the run and of its workers stays bounded.

Prints a table; exit code 1 where a bar is missed.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from simfoundry.assets.cache import Cache
from simfoundry.evaluate.task import load_task
from simfoundry.predicates import Judge
from simfoundry.scene.lower import lower
from simfoundry.spec.load import load_scene
from simfoundry.spec.yaml.text import parse
from simfoundry.worlds import open_world
from tests.conftest import REPOSITORY

PARTS = ("validity", "kills", "workers", "ray", "scale")
RECIPES = REPOSITORY / "specs" / "cousins"
MAIN = "import sys; from simfoundry.cli.main import main; sys.argv[0] = 'simfoundry'; main()"

SECONDS = 2.0
HOLD, OVERLAP, MOVED = 0.99, 0.001, 0.01
KILLS = 10
MANY = 10_000
GROWTH = 300 * 2**20
"""So many bytes more than after its first hundredth may the memory of a run be at its end."""


@dataclass(frozen=True)
class Read:
    """One cousin in one engine after :data:`SECONDS`: what is lost, the deepest overlap and the farthest way [m]."""

    file: str
    engine: str
    lost: tuple[str, ...]
    overlap: float
    moved: float
    who: str

    @property
    def is_valid(self) -> bool:
        """Whether it is as it was made."""
        return not self.lost and self.overlap <= OVERLAP and self.moved <= MOVED


# -- running ----------------------------------------------------------------------------------------------------------


def project(folder: Path) -> Path:
    """The specs as a project of their own, so that what is written lies beside them."""
    shutil.copytree(REPOSITORY / "specs", folder / "specs")
    (folder / "simfoundry.yaml").write_text("")
    return folder


def command(root: Path, recipe: str, out: str, count: int, *more: str) -> list[str]:
    """The command line that makes cousins."""
    path = root / "specs" / "cousins" / f"{recipe}.cousins.yaml"
    arguments = [str(path), "-o", str(root / "build" / out), "-n", str(count), "--json", *more]
    return [sys.executable, "-c", MAIN, "cousins", *arguments]


def environment() -> dict[str, str]:
    """That of this process, with this checkout first."""
    return {**os.environ, "PYTHONPATH": str(REPOSITORY)}


def make(root: Path, recipe: str, out: str, count: int, *more: str) -> Path:
    """Make cousins; raises CalledProcessError where the command fails."""
    line = command(root, recipe, out, count, *more)
    done = subprocess.run(line, env=environment(), capture_output=True, text=True, check=False)
    if done.returncode:
        print(done.stdout[-2000:], done.stderr[-2000:])
        raise subprocess.CalledProcessError(done.returncode, line)
    return root / "build" / out


def hashes(out: Path) -> dict[str, str]:
    """SHA-256 of every file by path, logs included."""
    files = (p for p in sorted(out.rglob("*")) if p.is_file())
    return {p.relative_to(out).as_posix(): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}


def same(first: Path, other: Path) -> bool:
    """Whether two folders hold the same bytes; says which files differ."""
    a, b = hashes(first), hashes(other)
    differ = sorted(path for path in a | b if a.get(path) != b.get(path))
    for path in differ[:5]:
        print(f"  {other.name}: {path} differs")
    return not differ


def recipes(axis: str) -> list[str]:
    """The recipes of the project that have an axis, by file."""
    found = {p.name.removesuffix(".cousins.yaml"): parse(p.read_text()).data for p in RECIPES.glob("*.cousins.yaml")}
    return sorted(name for name, data in found.items() if axis in data)


# -- parts ------------------------------------------------------------------------------------------------------------


def reread(scene: Path, asked: tuple[str, ...]) -> list[Read]:
    """A written cousin, let go in both engines; of a task that is done already its goal is lost."""
    lowered = lower(load_scene(scene), Cache.default())
    judge, task = Judge(lowered), scene.with_name(scene.name.replace(".scene.", ".task."))
    goal = load_task(task, Cache.default()).goal if task.is_file() else None
    found = []
    for engine in ("mujoco", "pybullet"):
        with open_world(lowered, engine) as world:
            world.reset()
            before = world.state()
            world.step(round(SECONDS / world.timestep))
            after, contacts = world.state(), world.contacts()
        lost = tuple(text for text in asked if not judge(text, after).value)
        lost += ("not its goal",) if goal is not None and judge(goal, after).value else ()
        deepest = max(contacts, key=lambda c: c.depth, default=None)
        free = [o.name for o in lowered.objects if not o.fixed]
        ways = {n: float(np.linalg.norm(after.poses[n].p - before.poses[n].p)) for n in free}
        far = max(ways, key=lambda n: ways[n])
        overlap = max(0.0, deepest.depth) if deepest is not None else 0.0
        who = f"{deepest.a}/{deepest.b}" if deepest is not None and overlap > OVERLAP else far
        found.append(Read(f"{scene.parent.name}/{scene.name}", engine, lost, overlap, ways[far], who))
    return found


def validity(root: Path, count: int, jobs: int, only: str = "") -> bool:
    """Every cousin of the recipes that have layouts, read back."""
    print(f"{'recipe':<23}{'engine':<10}{'cousins':>8}{'hold':>8}{'mm':>7}{'cm':>7}{'valid':>8}")
    good = True
    for recipe in [only] if only else recipes("scene"):
        out = make(root, recipe, recipe, count, "-j", str(jobs), "--gallery", "0")
        entries = [e for e in json.loads((out / "manifest.json").read_bytes())["cousins"] if "scene" in e["files"]]
        with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
            files = [out / entry["files"]["scene"] for entry in entries]
            reads = [r for some in pool.map(reread, files, [tuple(e["asked"]) for e in entries]) for r in some]
        for engine in ("mujoco", "pybullet"):
            good &= _row(recipe, engine, [r for r in reads if r.engine == engine])
    return good


def _row(recipe: str, engine: str, reads: list[Read]) -> bool:
    hold = sum(not r.lost for r in reads) / len(reads)
    valid = sum(r.is_valid for r in reads) / len(reads)
    overlap, moved = max(r.overlap for r in reads), max(r.moved for r in reads)
    print(
        f"{recipe:<23}{engine:<10}{len(reads):>8}{hold:>8.1%}{1000 * overlap:>7.2f}{100 * moved:>7.2f}{valid:>8.1%}",
        flush=True,
    )
    for r in [r for r in reads if not r.is_valid][:5]:
        print(f"  {r.file}: {', '.join(r.lost)} {1000 * r.overlap:.2f} mm, {100 * r.moved:.2f} cm ({r.who})")
    return hold >= HOLD and overlap <= OVERLAP and moved <= MOVED


def kills(root: Path, count: int, jobs: int, seed: int = 0) -> bool:
    """A run that is killed at random moments, and the same run left alone."""
    whole = make(root, "cup_in_bowl", "whole", count, "-j", str(jobs), "--gallery", "2")
    chance, killed = random.Random(seed), 0
    log = root / "build" / "killed" / ".cousins" / "log.jsonl"
    line = command(root, "cup_in_bowl", "killed", count, "-j", str(jobs), "--gallery", "2")
    for _ in range(KILLS):
        process = subprocess.Popen(
            line, env=environment(), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
        )
        goal = _lines(log) + chance.randrange(1, max(2, 2 * count // KILLS))
        while process.poll() is None and _lines(log) < min(goal, count - 1):
            time.sleep(0.02)
        time.sleep(chance.uniform(0.0, 0.5))  # in the midst of anything, the last files among it
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            killed += 1
        process.wait()
        print(f"  killed with {_lines(log)} candidates in the log", flush=True)
    resumed = make(root, "cup_in_bowl", "killed", count, "-j", str(jobs), "--gallery", "2")
    alike = same(whole, resumed)
    print(f"kills: {killed} of {KILLS} while running; same bytes: {alike}")
    return alike and killed > 0


def _lines(log: Path) -> int:
    return log.read_bytes().count(b"\n") if log.is_file() else 0


def workers(root: Path, count: int) -> bool:
    """One and two processes, and shards."""
    one = make(root, "stack_dishware", "one", count, "-j", "1", "--gallery", "2")
    two = make(root, "stack_dishware", "two", count, "-j", "2", "--gallery", "2")
    for shard in ("3/3", "1/3", "2/3"):
        make(root, "stack_dishware", "shards", count, "-j", "1", "--shard", shard)
    shards = make(root, "stack_dishware", "shards", count, "-j", "1", "--gallery", "2")
    alike = [same(one, two), same(one, shards)]
    print(f"workers: 1 and 2 the same bytes: {alike[0]}; three shards the same bytes: {alike[1]}")
    return all(alike)


def ray(root: Path, count: int) -> bool:
    """Local processes and Ray."""
    here = make(root, "stack_dishware", "here", count, "-j", "2", "--gallery", "0")
    there = make(root, "stack_dishware", "there", count, "-j", "2", "--gallery", "0", "--on", "ray")
    alike = same(here, there)
    print(f"ray: {count} cousins, the same bytes: {alike}")
    return alike


def memory(pids: Iterable[int]) -> int:
    """Resident memory of processes [B]; 0 for those that are gone."""
    total = 0
    for pid in pids:
        try:
            fields = Path(f"/proc/{pid}/statm").read_text().split()
            total += int(fields[1]) * os.sysconf("SC_PAGE_SIZE")
        except (OSError, IndexError):
            continue
    return total


def family(pid: int) -> list[int]:
    """A process and its children."""
    try:
        text = Path(f"/proc/{pid}/task/{pid}/children").read_text()
    except OSError:
        return [pid]
    tasks = Path(f"/proc/{pid}/task").glob("*/children")
    children = {int(c) for path in tasks for c in _text(path).split()} | {int(c) for c in text.split()}
    return [pid, *(p for child in sorted(children) for p in family(child))]


def _text(path: Path) -> str:
    try:
        return path.read_text()
    except OSError:
        return ""


def scale(root: Path, count: int, jobs: int) -> bool:
    """Many cousins of a light recipe in one run, with its memory over time."""
    (root / "specs" / "cousins" / "light.cousins.yaml").write_text(
        "simfoundry: cousins/1\nname: light\ntwin: ../scenes/cup_in_bowl.scene.yaml\nscene:\n  anchor: bowl\n"
        "  objects: {cup: [LeftOf, RightOf, InFrontOf, Behind]}\n"
    )
    started, seen = time.perf_counter(), list[tuple[int, int]]()
    line = command(root, "light", "light", count, "-j", str(jobs), "--gallery", "0")
    log = root / "build" / "light" / ".cousins" / "log.jsonl"
    process = subprocess.Popen(line, env=environment(), stdout=subprocess.PIPE, text=True)
    while process.poll() is None:
        time.sleep(1.0)
        size = log.stat().st_size if log.is_file() else 0
        seen.append((size, memory(family(process.pid))))
    assert process.stdout is not None
    facts = json.loads(process.stdout.read() or "{}")
    full = max(size for size, _ in seen)
    early = max((rss for size, rss in seen if size <= full / 100 + 20_000), default=0)
    peak, span = max(rss for _, rss in seen), time.perf_counter() - started
    files = len(list((root / "build" / "light").glob("*.scene.yaml")))
    print(
        f"scale: {facts.get('accepted')} cousins, {files} files, {facts.get('examined')} candidates, {span:.0f} s; "
        f"{early / 2**20:.0f} MiB resident after the first hundredth, {peak / 2**20:.0f} MiB at most, of all processes"
    )
    return process.returncode == 0 and files == count and peak - early <= GROWTH


def main(arguments: list[str] | None = None) -> int:
    """Run the parts; 1 where a bar is missed."""
    parser = argparse.ArgumentParser(description="Hold cousins against what is promised.")
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"of {', '.join(PARTS)}; by default all")
    parser.add_argument("-n", type=int, help="cousins: of each recipe, or of the run")
    parser.add_argument("-r", default="", metavar="RECIPE", help="one recipe, for `validity`")
    parser.add_argument("-j", type=int, default=2, help="processes")
    given = parser.parse_args(arguments)
    unknown = [part for part in given.parts if part not in PARTS]
    if unknown:
        parser.error(f"there is no part `{unknown[0]}`")
    good = True
    with tempfile.TemporaryDirectory() as folder:
        root = project(Path(folder))
        for part in given.parts or PARTS:
            match part:
                case "validity":
                    good &= validity(root, given.n or 100, given.j, given.r)
                case "kills":
                    good &= kills(root, given.n or 120, given.j)
                case "workers":
                    good &= workers(root, given.n or 40)
                case "ray":
                    good &= ray(root, given.n or 40)
                case "scale":
                    good &= scale(root, given.n or MANY, given.j)
    print("all bars are met" if good else "a bar is missed")
    return int(not good)


if __name__ == "__main__":
    sys.exit(main())
