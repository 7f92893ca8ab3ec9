"""The same bytes, whatever builds them: ``python -m tests.corpora.determinism``.

Compiles all of ``specs/``, a scene of concave meshes (CoACD) and, where the development data is there, robots, for all
four backends: in other processes, with other hash seeds, with a cold and a warm cache, by one and by two workers, one
scene at a time in process, and by another Python, which ``SIMFOUNDRY_OTHER_PYTHON`` names: an interpreter with the same
versions of the dependencies. Each build is compared with the first, byte by byte. Prints a table; exit code 1 where
bytes differ.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from simfoundry.assets.solids import prism_mesh
from tests.assets.meshes import blob, obj
from tests.conftest import REPOSITORY

OTHER = "SIMFOUNDRY_OTHER_PYTHON"
MAIN = "import sys; from simfoundry.cli.main import main; sys.argv[0] = 'simfoundry'; main()"
BACKENDS = ("mjcf", "pybullet", "urdf", "usd")
MESHES = 4
"""Meshes that are decomposed; half of them random."""

CONCAVE = """\
simfoundry: scene/1
name: concave
materials: {wood: {density: 500, friction: 0.6}}
objects:
  desk: {fixed: true, shape: {box: [4.0, 4.0, 0.1]}, material: wood, pose: {xyz: [0, 0, -0.05]}}
"""


@dataclass(frozen=True)
class Way:
    """A way to compile: the interpreter, its hash seed, the cache, the workers; without those, one scene at a time."""

    name: str
    python: str
    seed: str
    cache: str
    workers: int


def ways(other: str | None) -> list[Way]:
    """The first is what the others are held against."""
    here = sys.executable
    found = [
        Way("first", here, "0", "a", 2),
        Way("warm cache", here, "0", "a", 2),
        Way("another hash seed, cold cache", here, "12345", "b", 2),
        Way("one worker, random hash seed", here, "random", "c", 1),
        Way("one scene at a time, in process", here, "7", "d", 0),
    ]
    if other is not None:
        found += [
            Way("another Python, cold cache", other, "0", "e", 2),
            Way("another Python, on the cache of the first", other, "99", "a", 2),
        ]
    return found


def project(folder: Path) -> Path:
    """The specs, and scenes with concave meshes, as one project."""
    root = folder / "project"
    shutil.copytree(REPOSITORY / "specs", root / "specs")
    (root / "simfoundry.yaml").write_text("")
    rng = np.random.default_rng(2026)
    outline = np.array([[0, 0], [3, 0], [3, 1], [1, 1], [1, 3], [0, 3]]) * 0.05
    text = CONCAVE
    for k in range(MESHES):
        mesh = prism_mesh(outline * rng.uniform(0.8, 1.2), 0.05) if k % 2 else blob(rng, 30)
        (root / f"mesh{k}.obj").write_text(obj(*mesh))
        text += f"  mesh{k}: {{asset: mesh{k}.obj, collision: decompose, material: wood, pose: {{xyz: [{k}, 1, 1]}}}}\n"
    (root / "concave.scene.yaml").write_text(text)
    return root


def robots(folder: Path) -> dict[str, str]:
    """The environment in which robots are found; empty where their models are not here."""
    from simfoundry.spec.models.robot_file import OWN_ROBOTS
    from tests.robots.conftest import FRANKA_ROBOTIQ, YAM

    data = REPOSITORY.parent / "shared" / "data" / "robots"
    if not data.is_dir():
        return {}
    own = folder / "robots"
    own.mkdir()
    for name, text in (("franka_robotiq", FRANKA_ROBOTIQ), ("yam", YAM)):
        (own / f"{name}.yaml").write_text(text.format(robots=data))
    return {OWN_ROBOTS: str(own)}


def compile_with(way: Way, root: Path, out: Path, environment: Mapping[str, str]) -> None:
    """Compile every scene below ``root``; raises CalledProcessError where one fails."""
    env = {
        **os.environ,
        **environment,
        "PYTHONPATH": str(REPOSITORY),
        "PYTHONHASHSEED": way.seed,
        "SIMFOUNDRY_CACHE": str(out.parent / f"cache_{way.cache}"),
    }
    targets = [word for backend in BACKENDS for word in ("-t", backend)]
    calls = [[str(root), "-o", str(out), "-j", str(way.workers)]]
    if not way.workers:
        scenes = sorted(root.rglob("*.scene.yaml"))
        parts = [(path, path.relative_to(root).as_posix().removesuffix(".scene.yaml")) for path in scenes]
        calls = [[str(path), "-o", str(out / part)] for path, part in parts]
    for call in calls:
        command = [way.python, "-c", MAIN, "compile", *call, *targets]
        subprocess.run(command, env=env, check=True, capture_output=True, text=True)


def hashes(out: Path) -> dict[str, str]:
    """SHA-256 of every file by path."""
    files = (p for p in sorted(out.rglob("*")) if p.is_file())
    return {p.relative_to(out).as_posix(): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}


def versions(python: str) -> dict[str, str]:
    """Of the interpreter and of what shapes the bytes."""
    program = (
        "import json, platform; from simfoundry.targets.inputs import software;"
        "print(json.dumps({'python': platform.python_version()} | software()))"
    )
    env = {**os.environ, "PYTHONPATH": str(REPOSITORY)}
    done = subprocess.run([python, "-c", program], env=env, check=True, capture_output=True, text=True)
    found: dict[str, str] = json.loads(done.stdout)
    return found


def main() -> int:
    """Build in every way and compare; 1 where bytes differ, or a build fails."""
    other = os.environ.get(OTHER)
    print(f"here: {', '.join(f'{k} {v}' for k, v in versions(sys.executable).items())}")
    if other is None:
        print(f"no other Python: {OTHER} names none")
    else:
        print(f"other: {', '.join(f'{k} {v}' for k, v in versions(other).items())}")
    bad = 0
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        root, environment = project(folder), robots(folder)
        print(f"robots: {'from the development data' if environment else 'left out, their models are not here'}")
        first: dict[str, str] = {}
        print(f"{'built':<44}{'s':>6}{'files':>7}{'differ':>8}")
        for k, way in enumerate(ways(other)):
            started = time.perf_counter()
            try:
                compile_with(way, root, folder / f"out{k}", environment)
            except subprocess.CalledProcessError as error:
                print(f"{way.name}: FAILED\n{error.stdout}{error.stderr}")
                return 1
            found = hashes(folder / f"out{k}")
            first = first or found
            wanted = first if way.workers else {p: h for p, h in first.items() if not p.endswith("build.json")}
            differing = sorted(path for path in wanted | found if wanted.get(path) != found.get(path))
            print(f"{way.name:<44}{time.perf_counter() - started:>6.0f}{len(found):>7}{len(differing):>8}", flush=True)
            for path in differing[:10]:
                print(f"  {path}")
            bad += bool(differing)
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
