"""What several posed frames are worth: Chamfer distance of the objects from one frame and from eight.

    python -m tests.corpora.fusion [--tables 6] [--first 2000]

Each synthetic table is seen by its camera and from seven places around it, with the noise of its sensor. The scene from
the first frame alone and that from all eight are compared with the truth, over the objects that both found.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from simfoundry.assets.cache import Cache
from simfoundry.capture.accuracy import scene_accuracy
from simfoundry.capture.run import CaptureOptions, run_capture
from simfoundry.capture.synthesize import SENSORS, simulate_frame, write_capture
from simfoundry.errors import PicklableError
from simfoundry.geometry.frames import Array, look_at
from simfoundry.render.raycast import raycast
from simfoundry.scene.lower import lower
from simfoundry.scene.state import pose_spec
from simfoundry.spec.load import load_scene
from simfoundry.spec.models.capture import CaptureSpec, Shot
from simfoundry.spec.yaml.write import to_yaml
from tests.corpora.synthetic_tables import SyntheticTable, synthetic_table

FRAMES = 8


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
    options = parser.parse_args()
    rows = []
    print(f"{'seed':>6}{'true':>6}{'found by 1':>12}{'by 8':>6}{'Chamfer by 1':>14}{'by 8 [mm]':>11}")
    for seed in range(options.first, options.first + options.tables):
        row = compared(synthetic_table(seed))
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


def compared(table: SyntheticTable) -> Row | None:
    """Reconstruct a table from one frame and from eight, or return None if a run was refused."""
    with tempfile.TemporaryDirectory() as temporary:
        shots = written(table, Path(temporary))
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


def written(table: SyntheticTable, folder: Path) -> dict[str, Shot]:
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
        update = {"color": f"f{k}/{shot.color}", "depth": depth, "pose": pose_spec(X_WC)}
        shots[f"f{k}"] = shot.model_copy(update=update)
    return shots


def distances(table: SyntheticTable, capture: Path, out: Path) -> dict[str, float]:
    """The Chamfer distance [m] of each true object that was found."""
    run = run_capture(capture, out, cache=Cache(out.parent / "cache"), options=CaptureOptions("f0"))
    scene = lower(load_scene(run.scene_file))
    rendered = raycast(scene, scene.cameras[0])
    accuracy = scene_accuracy(table.scene, table.camera, scene, rendered, table.frame.color)
    return {o["name"]: float(o["chamfer"]) for o in accuracy.to_json()["objects"] if o["recovered"]}


if __name__ == "__main__":
    sys.exit(main())
