"""How fast things are placed and cousins found: prints medians of one run.

    python -m tests.benchmarks.placing [--runs 7] [--seconds 20]

``boxes`` are 100 boxes of 4 x 5 x 6 cm on a table of 1.6 x 0.9 m; ``parts`` 100 things of specs/assets, each of several
convex parts, on a table of 2.5 x 2.5 m, every pair whose bounds meet tested on its real parts. Both are placed anew in
each run, on one core, and timed in turns with scene-synthesizer, which puts the same boxes on the same table where
``SCENE_SYNTHESIZER_PYTHON`` names the Python of an environment that has it::

    python3.11 -m venv synth && synth/bin/pip install scene-synthesizer==1.15.0 usd-core
    export SCENE_SYNTHESIZER_PYTHON=$PWD/synth/bin/python

``processor`` counts processor time instead, for machines that others keep busy. ``cousins`` have ten objects moved in
the cluttered scene of specs/, with a task: layouts proposed, settled and checked in two processes for so many seconds.
The arm's reach is checked where its model is, which the last line says.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np

from simfoundry.cousins.layout.acceptance import examine
from simfoundry.cousins.layout.propose import Layout, propose, scatter
from simfoundry.cousins.layout.twin import Twin
from simfoundry.cousins.layout.twin_objects import TwinRobots
from simfoundry.scene.lower import lower
from simfoundry.scene.state import SceneState
from simfoundry.spec.load import load
from simfoundry.spec.models.cousins import SceneAxis, Side

REPOSITORY = Path(__file__).resolve().parents[2]
COUNT = 100
SIDES: tuple[Side, ...] = ("LeftOf", "RightOf", "InFrontOf", "Behind", "NextTo")
TASK = REPOSITORY / "specs/tasks/tennis_ball_in_bowl.task.yaml"
MOVED = ("orange_cup", "red_bottle", "baseball", "tennis_ball", "burger", "blue_cup", "black_eraser", "black_marker",
         "orange_marker", "mug")  # fmt: skip
CLEARER = ("brown_box", "cabinet", "gallery", "stove", "trash_can", "pot")
"""Assets that are too large to be scattered a hundred at a time."""

HEAD = "simfoundry: scene/1\nname: {name}\nmaterials: {{wood: {{density: 600, friction: 0.5}}}}\nobjects:\n"
TOP = "  table: {{fixed: true, shape: {{box: [{x}, {y}, 0.04]}}, material: wood, pose: {{xyz: [0, 0, -0.02]}}}}\n"

PEER = """
import logging, sys, time, numpy as np, scene_synthesizer as synth
from scene_synthesizer import procedural_assets as pa
logging.disable(logging.ERROR)
bottom = ("center", "center", "bottom")
print("ready", flush=True)
for _ in sys.stdin:
    scene = synth.Scene(seed=0)
    scene.add_object(pa.TableAsset(width=1.6, depth=0.9, height=0.75, origin=bottom), "table")
    scene.label_support("top", obj_ids="table")
    start, clock = time.perf_counter(), time.process_time()
    for k in range(COUNT):
        box = synth.BoxAsset([0.04, 0.05, 0.06], origin=bottom)
        assert scene.place_object(f"b{k}", box, support_id="top", max_iter=200)
    print(time.perf_counter() - start, time.process_time() - clock, flush=True)
"""


def boxes(folder: Path) -> Twin:
    """The table with its boxes in rows."""
    rows = [HEAD.format(name="boxes"), TOP.format(x=1.6, y=0.9)]
    for k in range(COUNT):
        x, y = -0.75 + 0.15 * (k % 11), -0.4 + 0.085 * (k // 11)
        shape = "{box: [0.04, 0.05, 0.06]}"
        rows.append(f"  b{k}: {{shape: {shape}, material: wood, pose: {{xyz: [{x:.3f}, {y:.3f}, 0.03]}}}}\n")
    return _twin(folder / "boxes.scene.yaml", rows)


def parts(folder: Path) -> Twin:
    """The assets of specs/ in rows, again and again."""
    names = [p.name.partition(".")[0] for p in sorted((REPOSITORY / "specs/assets").glob("*.asset.yaml"))]
    names = [name for name in names if name not in CLEARER]
    shutil.copytree(REPOSITORY / "specs/assets", folder / "assets")
    rows = [HEAD.format(name="parts"), TOP.format(x=2.5, y=2.5)]
    for k in range(COUNT):
        place = f"{{on: table, xy: [{-1.1 + 0.24 * (k % 10):.2f}, {-1.1 + 0.24 * (k // 10):.2f}]}}"
        rows.append(f"  t{k}: {{asset: assets/{names[k % len(names)]}.asset.yaml, place: {place}}}\n")
    return _twin(folder / "parts.scene.yaml", rows)


def _twin(path: Path, rows: list[str]) -> Twin:
    path.write_text("".join(rows))
    scene = lower(load(path))
    standing = {item.name: ("table",) for item in scene.objects if not item.fixed}
    return Twin(scene, SceneState.initial(scene), None, TwinRobots(scene, ()), standing)  # at rest


def placed(twin: Twin) -> Callable[[int], tuple[float, float]]:
    """Places everything on the table anew; seconds, and seconds of processor."""
    names = [item.name for item in twin.scene.objects if not item.fixed]

    def work(run: int) -> tuple[float, float]:
        start, clock = time.perf_counter(), time.process_time()
        layout = scatter(twin, names, np.random.default_rng([run]))
        spent = time.perf_counter() - start, time.process_time() - clock
        assert isinstance(layout, Layout) and len(layout.poses) == COUNT
        return spent

    return work


class Peer:
    """scene-synthesizer, which places the boxes once for each call."""

    def __init__(self) -> None:
        environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
        command = [os.environ["SCENE_SYNTHESIZER_PYTHON"], "-c", PEER.replace("COUNT", str(COUNT))]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment
        )
        self._read()

    def _read(self) -> str:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise RuntimeError("scene-synthesizer does not work: see above")
        return line

    def __call__(self, run: int) -> tuple[float, float]:
        """Seconds, and seconds of processor."""
        assert self._process.stdin is not None
        self._process.stdin.write("\n")
        self._process.stdin.flush()
        seconds, processor = self._read().split()
        return float(seconds), float(processor)


def cousins(part: int, seconds: float) -> tuple[int, float, Counter[str], str]:
    """Proposes and examines for so long; how many were accepted, in how much processor time [s], why the others were
    not, and what was not checked."""
    twin = Twin.load(TASK)
    asked = SceneAxis(anchor="bowl", objects=dict.fromkeys(MOVED, SIDES), gap=(0.02, 0.3))
    first = propose(twin, asked, np.random.default_rng(0))
    unchecked = examine(twin, first).unchecked if isinstance(first, Layout) else ()
    reasons: Counter[str] = Counter()
    accepted, k, start, clock = 0, part, time.perf_counter(), time.process_time()
    while time.perf_counter() - start < seconds:
        layout = propose(twin, asked, np.random.default_rng([1, k]))
        k += 2
        found = examine(twin, layout).reasons if isinstance(layout, Layout) else layout.reasons
        accepted += not found
        reasons.update({reason.code for reason in found})
    return accepted, time.process_time() - clock, reasons, "; ".join(unchecked)


def main(arguments: list[str]) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--runs", type=int, default=7)
    parser.add_argument("--seconds", type=float, default=20.0)
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        works: dict[str, Callable[[int], tuple[float, float]]] = {
            "boxes": placed(boxes(Path(folder))),
            "parts": placed(parts(Path(folder))),
        }
        if os.environ.get("SCENE_SYNTHESIZER_PYTHON"):
            works["scene-synthesizer"] = Peer()
        times: dict[str, list[tuple[float, float]]] = {name: [] for name in works}
        for run in range(-1, options.runs):
            for name, work in works.items():
                times[name].append(work(run + 1))
    print(f"{'placements a second':>22} {'processor':>10} {'ratio':>7}")
    rates = {}
    for name, found in times.items():
        wall, processor = (statistics.median(column) for column in zip(*found[1:], strict=True))
        rates[name] = COUNT / wall
        ratio = rates["boxes"] / rates[name] if name == "scene-synthesizer" else float("nan")
        print(f"{name:>18} {rates[name]:9.0f} {COUNT / processor:10.0f} {ratio:7.1f}")
    with ProcessPoolExecutor(2, multiprocessing.get_context("spawn")) as pool:
        told = list(pool.map(cousins, range(2), [options.seconds] * 2))
    accepted, processor = sum(one[0] for one in told), sum(one[1] for one in told)
    reasons = sum((one[2] for one in told), Counter[str]())
    print(f"cousins of ten objects, accepted a second in two processes: {accepted / options.seconds:.1f}", end="")
    print(f", were both processors theirs: {2 * accepted / processor:.1f}; rejected: {dict(reasons)}")
    print(f"not checked: {told[0][3] or 'nothing was left out'}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
