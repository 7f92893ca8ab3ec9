"""How long 1,000 objects take that one `repeat` describes: prints medians and their ratios.

    python -m tests.benchmarks.repeat [--rounds 7]

`simfoundry check` runs in processes of its own, in turns with a process that only imports PyYAML, pydantic and click,
which no check can do without. The bars are ratios to it: 5 for the structure (`--no-lints`) and 12 with the geometry. A
compile to MJCF, in one process, must not take longer than that of the same objects written out (`simfoundry flatten`).
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from simfoundry.backends import compile_scene
from simfoundry.scene.lower import lower
from simfoundry.spec.load import load
from tests.conftest import REPOSITORY

SCENE = """\
simfoundry: scene/1
name: warehouse
materials:
  card: {density: 200, friction: 0.5}
objects:
  floor: {fixed: true, shape: {box: [30, 40, 0.2]}, pose: {xyz: [11, 8, -0.1]}}
  parcel:
    shape: {box: [0.3, 0.2, 0.15]}
    material: card
    place: {on: floor}
    repeat: {count: [25, 40], step: [0.6, 0.4]}
"""
RELATION = "relations: ['OnTop(parcel, floor)']\n"
"""A relation that stands for 1,000, one for each copy; without a bar."""

BASELINE = (sys.executable, "-c", "import yaml, pydantic, click")
STRUCTURE, GEOMETRY = 5.0, 12.0
"""The largest ratios to the baseline."""

# Scatter of the median of a few rounds on a machine that others use; a slower compile is slower by more than this.
SCATTER = 1.05


def main() -> int:
    """Print the table; 1 where a bar is missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=7)
    rounds = parser.parse_args().rounds
    with tempfile.TemporaryDirectory() as folder:
        path, related, flat = (Path(folder) / f"{name}.scene.yaml" for name in ("repeat", "related", "flat"))
        path.write_text(SCENE)
        related.write_text(SCENE + RELATION)
        command = (sys.executable, "-m", "simfoundry")
        flat.write_text(_run(*command, "flatten", str(path)))
        check = (*command, "check")
        times = in_turns(
            {
                "import yaml, pydantic, click": lambda: _run(*BASELINE),
                "check --no-lints": lambda: _run(*check, str(path), "--no-lints"),
                "check": lambda: _run(*check, str(path)),
                "compile, repeated": lambda: _compile(path),
                "compile, written out": lambda: _compile(flat),
                "check --no-lints, with a relation": lambda: _run(*check, str(related), "--no-lints"),
                "check, with a relation": lambda: _run(*check, str(related)),
            },
            rounds,
        )
    baseline, structure, geometry, repeated, written, *_ = times.values()
    for name, seconds in times.items():
        print(f"{name:34} {seconds * 1e3:8.0f} ms {seconds / baseline:6.2f} x")
    print(f"compile: {repeated / written:.2f} x of the objects written out")
    return int(structure > STRUCTURE * baseline or geometry > GEOMETRY * baseline or repeated > SCATTER * written)


def in_turns(actions: dict[str, Callable[[], object]], rounds: int) -> dict[str, float]:
    """The median time of each action [s], run in turns so that what disturbs one disturbs all; once more to warm up."""
    times: dict[str, list[float]] = {name: [] for name in actions}
    for k in range(rounds + 1):
        for name, action in actions.items():
            start = time.perf_counter()
            action()
            if k:
                times[name].append(time.perf_counter() - start)
    return {name: statistics.median(found) for name, found in times.items()}


def _run(*command: str) -> str:
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONDONTWRITEBYTECODE"}
    environment["PYTHONPATH"] = str(REPOSITORY)
    return subprocess.run(command, check=True, capture_output=True, text=True, env=environment).stdout


def _compile(path: Path) -> object:
    return compile_scene(lower(load(path)), "mjcf")


if __name__ == "__main__":
    sys.exit(main())
