"""What several posed frames are worth: Chamfer distance of the objects from one frame and from eight.

    python -m tests.corpora.fusion [--tables 6] [--first 2000] [--pose-noise]

Each synthetic table is seen by its camera and from seven places around it, with the noise of its sensor; with
`--pose-noise`, the stated pose of each camera but the first is off by 3 mm (standard deviation along each axis) and 0.3
degrees. The scene from the first frame alone and that from all eight are compared with the truth, over the objects that
both found.
"""

from __future__ import annotations

import argparse
import math
import statistics
import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from simfoundry.assets.cache import Cache
from simfoundry.capture.accuracy.scene_accuracy import compare, surface, surface_distance
from simfoundry.capture.run import CaptureOptions, run_capture
from simfoundry.capture.synthesize import SENSORS, simulate_frame, write_capture
from simfoundry.errors import PicklableError
from simfoundry.geometry.frames import Array, Pose, look_at
from simfoundry.render.raycast import raycast
from simfoundry.scene.lower import lower
from simfoundry.scene.state import pose_spec
from simfoundry.spec.load import load_scene
from simfoundry.spec.models.capture import CaptureSpec, Shot
from simfoundry.spec.yaml.write import to_yaml
from tests.corpora.synthetic_tables import SyntheticTable, synthetic_table

FRAMES = 8

SHIFT_M, TURN_DEG = 0.003, 0.3
"""Errors of a tracker of cameras: the standard deviation along each axis, and the angle about a random axis."""

SAMPLES = 40000
"""Points on each surface: two samples of 4,000 of one surface are 1 to 2 mm apart, more than what frames change."""


@dataclass(frozen=True)
class Row:
    """A table: Chamfer distances [m] of the objects that both runs found, and the numbers of objects."""

    seed: int
    true: int
    found: tuple[int, int]
    chamfer: tuple[float, float]


def main() -> int:
    """Print the table; 1 if eight frames are not better than one over all objects."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--tables", type=int, default=6)
    parser.add_argument("--first", type=int, default=2000, metavar="SEED")
    parser.add_argument("--pose-noise", action="store_true")
    options = parser.parse_args()
    rows = []
    print(f"{'seed':>6}{'true':>6}{'found by 1':>12}{'by 8':>6}{'Chamfer by 1':>14}{'by 8 [mm]':>11}")
    for seed in range(options.first, options.first + options.tables):
        row = judged(synthetic_table(seed), options.pose_noise)
        if row is None:
            print(f"{seed:>6}  refused")
            continue
        rows.append(row)
        one, eight = (1000 * value for value in row.chamfer)
        print(f"{seed:>6}{row.true:>6}{row.found[0]:>12}{row.found[1]:>6}{one:>14.2f}{eight:>11.2f}", flush=True)
    one, eight = (1000 * statistics.mean(row.chamfer[k] for row in rows) for k in (0, 1))
    better = sum(row.chamfer[1] < row.chamfer[0] for row in rows)
    print(f"mean Chamfer distance: one {one:.2f} mm, eight {eight:.2f} mm; better on {better} of {len(rows)}")
    return 0 if eight < one else 1


def judged(table: SyntheticTable, pose_noise: bool = False) -> Row | None:
    """Reconstruct a table from one frame and from eight, or return None if a run was refused."""
    with tempfile.TemporaryDirectory() as temporary:
        shots = written(table, Path(temporary), pose_noise)
        found = []
        for name, used in (("one", list(shots)[:1]), ("eight", list(shots))):
            spec = CaptureSpec(simfoundry="capture/1", name=name, frames={key: shots[key] for key in used})
            file = Path(temporary) / f"{name}.capture.yaml"
            file.write_text(to_yaml(spec))
            try:
                found.append(distances(table, file, Path(temporary) / f"{name}_out"))
            except PicklableError:
                return None
    both = sorted(set(found[0]) & set(found[1]))
    if not both:
        return None
    chamfer = tuple(statistics.mean(each[name] for name in both) for each in found)
    return Row(table.seed, table.count, (len(found[0]), len(found[1])), (chamfer[0], chamfer[1]))


def written(table: SyntheticTable, folder: Path, pose_noise: bool = False) -> dict[str, Shot]:
    """Write the frames of a table: that of its camera, and of cameras up to 20 cm beside it."""
    rng, shots = np.random.default_rng(table.seed), {}
    camera = table.camera
    target: Array = camera.X_WC.apply(np.array([[0.0, 0.0, float(np.nanmedian(table.frame.depth))]]))[0]
    for k in range(FRAMES):
        frame, X_WC = table.frame, camera.X_WC
        if k:
            X_WC = look_at(camera.X_WC.p + rng.uniform(-0.2, 0.2, 3) * [1, 1, 0.5], target)
            ray = raycast(table.scene, replace(camera, X_WC=X_WC))
            frame = replace(simulate_frame(ray, rng, SENSORS[table.sensor]), instances=None)
        shot = write_capture(folder / f"f{k}", frame)
        assert shot.depth is not None
        depth = shot.depth.model_copy(update={"image": f"f{k}/{shot.depth.image}"})
        stated = _disturbed(X_WC, np.random.default_rng((table.seed, k))) if k and pose_noise else X_WC
        update = {"color": f"f{k}/{shot.color}", "depth": depth, "pose": pose_spec(stated)}
        shots[f"f{k}"] = shot.model_copy(update=update)
    return shots


def _disturbed(X_WC: Pose, rng: np.random.Generator) -> Pose:
    """A pose as a tracker would state it."""
    axis = rng.normal(size=3)
    turn = Pose.about(axis / np.linalg.norm(axis), math.radians(TURN_DEG))
    return Pose.of(X_WC.p + rng.normal(0, SHIFT_M, 3), X_WC.q) @ turn


def distances(table: SyntheticTable, capture: Path, out: Path) -> dict[str, float]:
    """The Chamfer distance [m] of each true object that was found."""
    run = run_capture(capture, out, cache=Cache(out.parent / "cache"), options=CaptureOptions("f0"))
    scene = lower(load_scene(run.scene_file))
    camera = scene.cameras[0]
    true, found = ({o.name: o for o in each.objects} for each in (table.scene, scene))
    X_found_truth = camera.X_WC @ table.camera.X_WC.inverse()
    compared = compare(table.scene, table.camera, scene, camera)
    pairs = [(o.name, true[o.name], found[o.recovered]) for o in compared if o.recovered]
    return {
        name: surface_distance(surface(a, X_found_truth @ a.X_WO, SAMPLES), surface(b, b.X_WO, SAMPLES))[0]
        for name, a, b in pairs
    }


if __name__ == "__main__":
    sys.exit(main())
