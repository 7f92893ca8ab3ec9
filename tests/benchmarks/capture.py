"""Times of `simfoundry capture`: prints wall and processor time, memory and objects of each run, and what misses a bar.

    python -m tests.benchmarks.capture [--tables 5] [--large]

Synthetic tables of 640 x 480 pixels with about ten objects go through the command in processes of its own: once, once
more without a change, and once after the mask of one object was changed. `--large` adds a table of 3840 x 2160 pixels.
On a machine that others use, processor time (user and system) is what can be compared.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from PIL import Image

from simfoundry.capture.synthesize import SENSORS, simulate_frame, write_capture
from simfoundry.render.raycast import raycast
from simfoundry.spec.models.capture import CaptureSpec
from simfoundry.spec.yaml.write import to_yaml
from tests.corpora.synthetic_tables import SyntheticTable, synthetic_table

# Seeds of tables with nine or ten objects.
SEEDS = (1015, 1018, 1021, 1034, 1041)

MEDIAN_S, WORST_S, AGAIN_S = 10.0, 40.0, 3.0
"""The bars: median and largest wall time of a first run, and wall time after one changed mask [s]."""

LARGE_S, LARGE_MB = 60.0, 2000.0
"""The bars of a picture of 3840 x 2160 pixels [s], [MB]."""


@dataclass(frozen=True)
class Run:
    """What a command took: wall time, processor time [s] and memory [MB]."""

    wall: float
    processor: float
    memory: float
    objects: int


def main() -> int:
    """Print the table; 1 where a bar is missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tables", type=int, default=len(SEEDS))
    parser.add_argument("--large", action="store_true")
    options = parser.parse_args()
    first, again = [], []
    with tempfile.TemporaryDirectory() as temporary:
        for seed in SEEDS[: options.tables]:
            table = synthetic_table(seed)
            folder = written(table, Path(temporary) / f"table{seed}")
            runs = {"first": run(folder), "unchanged": run(folder)}
            change_mask(folder.with_name(f"{folder.name}_out") / "masks.png")
            runs["one mask"] = run(folder)
            first.append(runs["first"])
            again.append(runs["one mask"])
            for name, one in runs.items():
                print(f"table {seed:3d}, {table.count:2d} objects, {name:<10}{text(one)}", flush=True)
        missed = [
            *over("median of first runs", statistics.median(r.wall for r in first), MEDIAN_S, "s"),
            *over("slowest first run", max(r.wall for r in first), WORST_S, "s"),
            *over("slowest run after one changed mask", max(r.wall for r in again), AGAIN_S, "s"),
        ]
        if options.large:
            large = run(written(enlarged(synthetic_table(SEEDS[0])), Path(temporary) / "large"))
            print(f"3840 x 2160 pixels{'':16}{text(large)}")
            missed += over("3840 x 2160", large.wall, LARGE_S, "s")
            missed += over("3840 x 2160", large.memory, LARGE_MB, "MB")
    ratios = [b.processor / a.processor for a, b in zip(first, again, strict=True)]
    middle, slowest = statistics.median(r.processor for r in first), max(r.processor for r in first)
    again_share = statistics.median(ratios)
    print(f"processor time: median {middle:.1f} s, slowest {slowest:.1f} s, changed mask {again_share:.2f} of it")
    for line in missed:
        print(f"missed: {line}")
    return 1 if missed else 0


def text(one: Run) -> str:
    """A run as a line of the table."""
    return f"{one.wall:6.1f} s wall {one.processor:6.1f} s processor {one.memory:6.0f} MB {one.objects:3d} found"


def over(name: str, value: float, bar: float, unit: str) -> list[str]:
    """A line if a value exceeds its bar."""
    return [f"{name} {value:.1f} {unit}, bar {bar:g}"] if value > bar else []


def written(table: SyntheticTable, folder: Path) -> Path:
    """Write the capture of a table."""
    shot = write_capture(folder, table.frame)
    spec = CaptureSpec(simfoundry="capture/1", name="table", frames={"view": shot})
    (folder / "capture.yaml").write_text(to_yaml(spec))
    return folder


def enlarged(table: SyntheticTable) -> SyntheticTable:
    """A table as a camera of 3840 x 2160 pixels sees it."""
    c = table.camera
    camera = replace(c, width=3840, height=2160, fx=c.fx * 4.5, fy=c.fy * 4.5, cx=1919.5, cy=1079.5)
    ray = raycast(table.scene, camera)
    frame = simulate_frame(ray, np.random.default_rng(0), SENSORS[table.sensor])
    return replace(table, camera=camera, frame=replace(frame, instances=None))


def change_mask(file: Path) -> None:
    """Take the top fifth of an object from its mask, as a person might in an image editor."""
    with Image.open(file) as image:
        palette, masks = image.getpalette(), np.array(image)
    k = int(np.bincount(masks[masks > 0]).argmax())
    rows, _ = np.nonzero(masks == k)
    masks[(masks == k) & (np.arange(len(masks))[:, None] < np.quantile(rows, 0.2))] = 0
    changed = Image.fromarray(masks, mode="P")
    changed.putpalette(palette or [])
    changed.save(file)


def run(folder: Path) -> Run:
    """Run the command for a capture, in a process of its own."""
    out = folder.with_name(f"{folder.name}_out")
    command = (sys.executable, "-m", "simfoundry", "capture", str(folder), "-o", str(out))
    start = time.perf_counter()
    # Modules are compiled once, as in an installed package, whatever the environment of this process says.
    environment = {**os.environ, "PYTHONPYCACHEPREFIX": str(folder.parent / "modules"), "PYTHONDONTWRITEBYTECODE": ""}
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, env=environment)
    assert process.stdout is not None
    said = process.stdout.read()
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode not in (0, 1):
        raise RuntimeError(f"{' '.join(command)} exited with {process.returncode}: {said}")
    wall = time.perf_counter() - start
    found = said.strip().splitlines()[-1].split(" objects")[0].split()[-1]
    return Run(wall, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024, int(found))


if __name__ == "__main__":
    sys.exit(main())
