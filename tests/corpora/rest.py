"""Captured scenes stay at rest in both simulators: ``python -m tests.corpora.rest [N] [--first SEED]``.

Synthetic tables, with ``--real`` real ones and with ``--piles`` piles of eight YCB objects, are captured by the whole
command. Every object of the written scene is then simulated for two seconds in MuJoCo and in PyBullet, and must stay
within 1 cm and 5 degrees. Every segment must have become an object, and at most 5 % of them may be held in place. Exit
code 1 if a bar is missed.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from simfoundry.capture.findings import HELD
from simfoundry.capture.frame import Frame
from simfoundry.capture.run import run_capture
from simfoundry.capture.synthesize import write_capture
from simfoundry.errors import SimfoundryError
from simfoundry.scene.lower import lower_file
from simfoundry.spec.models.capture import CaptureSpec
from simfoundry.spec.yaml.write import to_yaml
from simfoundry.worlds import open_world
from simfoundry.worlds.rest import ObjectMotion, simulate
from tests.corpora.segmentation import DATA, labelled_pictures
from tests.corpora.synthetic_tables import synthetic_table
from tests.corpora.ycb_scenes import pile

ENGINES = ("mujoco", "pybullet")
MAX_HELD = 0.05


@dataclass(frozen=True)
class Rested:
    """One scene: segments, objects, those held in place, and what moves too far in each engine."""

    name: str
    segments: int
    objects: int
    held: int
    moving: dict[str, tuple[ObjectMotion, ...]]
    farthest: dict[str, float]
    seconds: float


def rested(name: str, frame: Frame, folder: Path) -> Rested:
    """Capture a frame, and simulate the written scene.

    Raises:
        SimfoundryError: The capture is refused.
    """
    shot = write_capture(folder / "capture", frame)
    document = CaptureSpec(simfoundry="capture/1", name="table", frames={"first": shot})
    (folder / "capture" / "capture.yaml").write_text(to_yaml(document))
    start = time.process_time()
    run = run_capture(folder / "capture", folder / "out")
    seconds = time.process_time() - start
    scene = lower_file(run.scene_file)
    moving: dict[str, tuple[ObjectMotion, ...]] = {}
    farthest: dict[str, float] = {}
    for engine in ENGINES:
        with open_world(scene, engine) as world:
            motions = simulate(world, 2.0)
        moving[engine] = tuple(m for m in motions if not m.stays)
        farthest[engine] = max((m.moved for m in motions), default=0.0)
    labels = run.reconstruction.segmentation.labels
    held = sum(f.code == HELD for f in run.findings)
    return Rested(name, len(np.unique(labels[labels > 0])), len(scene.objects) - 1, held, moving, farthest, seconds)


def frames(first: int, count: int, real: int, data: Path, piles: int) -> Iterator[tuple[str, Frame]]:
    """Names and frames of synthetic tables, then of real ones, then of piles."""
    for seed in range(first, first + count):
        yield f"seed {seed}", synthetic_table(seed).frame
    for k, (name, frame, _) in enumerate(labelled_pictures(data) if real else ()):
        if k >= real:
            break
        yield name, frame
    for seed in range(first, first + piles):
        yield f"pile {seed}", pile(seed).frame


def main() -> int:
    """Capture, simulate and print; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("count", type=int, nargs="?", default=30, help="number of synthetic tables")
    parser.add_argument("--first", type=int, default=0, metavar="SEED", help="seed of the first one")
    parser.add_argument("--real", type=int, default=0, metavar="N", help="number of real tables")
    parser.add_argument("--piles", type=int, default=0, metavar="N", help="number of piles")
    parser.add_argument("--data", type=Path, default=DATA, help="folder of the real tables")
    options = parser.parse_args()
    scenes = []
    for name, frame in frames(options.first, options.count, options.real, options.data, options.piles):
        with tempfile.TemporaryDirectory(prefix="simfoundry-rest-") as folder:
            try:
                scene = rested(name, frame, Path(folder))
            except SimfoundryError as error:
                print(f"{name:12} refused: {str(error).splitlines()[0]}", flush=True)
                continue
        scenes.append(scene)
        motion = "  ".join(f"{e} {scene.farthest[e] * 1000:.1f} mm" for e in ENGINES)
        counts = f"{scene.segments} segments {scene.objects} objects {scene.held} held"
        print(f"{name:12} {counts}  {motion}  {scene.seconds:.0f} s", flush=True)
        for engine, motions in scene.moving.items():
            for m in motions:
                print(f"  MOVES in {engine}: {m.name} {m.moved * 1000:.1f} mm, {m.turned_deg:.1f} deg", flush=True)
    objects, held = sum(s.objects for s in scenes), sum(s.held for s in scenes)
    lost = sum(s.segments - s.objects for s in scenes)
    moving = {e: sum(len(s.moving[e]) for s in scenes) for e in ENGINES}
    print(f"{len(scenes)} scenes, {objects} objects: {lost} dropped, {held} held, moving {moving}")
    return int(bool(lost or any(moving.values()) or held > MAX_HELD * objects))


if __name__ == "__main__":
    raise SystemExit(main())
