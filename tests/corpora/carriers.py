"""Objects on and in other objects: do scenes from synthetic captures have them where they stand?

    python -m tests.corpora.carriers [--tables 12] [--first 0] [--masks]

Each table carries a tray, an open box, a bowl, a plate, a box or a book, with one or two objects on it or in it, and an
object beside it, as a depth camera sees them. With `--masks`, the capture states the true masks. A scene is right if
every object was found, stands on what it stands on in truth, stays where it was seen, and none is held in place.
"""

from __future__ import annotations

import argparse
import math
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from simfoundry.assets.cache import Cache
from simfoundry.capture.accuracy.scene_accuracy import compare
from simfoundry.capture.findings import HELD, LEFT_OUT, MOVED
from simfoundry.capture.frame import Frame
from simfoundry.capture.run import CaptureRun, run_capture
from simfoundry.capture.synthesize import SENSORS, simulate_frame, write_capture
from simfoundry.errors import PicklableError
from simfoundry.geometry.frames import Array, Pose, frozen_array, quat_from_rpy
from simfoundry.geometry.shapes import Box, Cylinder, Geometry, Sphere
from simfoundry.render.raycast import raycast
from simfoundry.scene.lower import lower
from simfoundry.scene.model import Camera, Scene, SceneObject
from simfoundry.spec.load import load_scene
from simfoundry.spec.models.capture import CaptureSpec
from simfoundry.spec.models.predicate import parse_call
from simfoundry.spec.yaml.write import to_yaml
from tests.corpora import synthetic_tables as tables

Rng = np.random.Generator
Parts = list[tuple[Geometry, Pose, Array]]


@dataclass(frozen=True, eq=False)
class Carrier:
    """A carrier on z = 0: its parts, the height [m] of what carries, and the half sides [m] of the room on it."""

    kind: str
    parts: Parts
    floor: float
    room: tuple[float, float]


@dataclass(frozen=True, eq=False)
class CarrierTable:
    """A table with the truth: what each object stands on, by name; `table` is the support."""

    seed: int
    kind: str
    scene: Scene
    camera: Camera
    sensor: str
    frame: Frame
    carriers: dict[str, str]


@dataclass(frozen=True)
class CarriedObjects:
    """Numbers of objects in truth, found, and on what carries them in truth; and what else is wrong."""

    true: int
    found: int
    right: int
    passed: bool
    problems: tuple[str, ...]

    @property
    def is_right(self) -> bool:
        """Whether everything is where it is in truth."""
        return self.found == self.true == self.right and not self.problems


def main() -> int:
    """Print the table; 1 if fewer than 80 % of the scenes are right."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--tables", type=int, default=12)
    parser.add_argument("--first", type=int, default=0, metavar="SEED")
    parser.add_argument("--masks", action="store_true")
    options = parser.parse_args()
    results = []
    print(f"{'seed':>6}  {'carrier':<10}{'sensor':<18}{'true':>5}{'found':>6}{'carrier right':>14}  passed")
    for seed in range(options.first, options.first + options.tables):
        table = carrier_table(seed)
        one = judged(table, options.masks)
        results.append(one)
        row = f"{seed:>6}  {table.kind:<10}{table.sensor:<18}{one.true:>5}{one.found:>6}{one.right:>14}"
        print(f"{row}  {'yes' if one.passed else 'no':<4} {'; '.join(one.problems)}", flush=True)
    return summarized(results)


def judged(table: CarrierTable, with_masks: bool) -> CarriedObjects:
    """Reconstruct a table, and compare what stands on what with the truth."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        frame = table.frame if with_masks else replace(table.frame, instances=None)
        spec = CaptureSpec(simfoundry="capture/1", name="carriers", frames={"view": write_capture(folder, frame)})
        (folder / "capture.yaml").write_text(to_yaml(spec))
        try:
            run = run_capture(folder / "capture.yaml", folder / "out", cache=Cache(folder / "cache"))
            return _result(table, run)
        except PicklableError as error:
            return CarriedObjects(len(table.carriers), 0, 0, False, (f"refused: {error}"[:120],))


def _result(table: CarrierTable, run: CaptureRun) -> CarriedObjects:
    scene = lower(load_scene(run.scene_file))
    compared = compare(table.scene, table.camera, scene, scene.cameras[0])
    name_of = {o.name: o.recovered for o in compared if o.recovered} | {"table": "table"}
    calls = [parse_call(text) for text in run.reconstruction.spec.relations]
    stands = {(call.args[0], call.args[1]) for call in calls if call.predicate == "OnTop"}
    free = sum(not o.fixed for o in scene.objects)
    right = sum((name_of.get(upper), name_of.get(lower)) in stands for upper, lower in table.carriers.items())
    problems = tuple(f"{f.code} {f.message}"[:100] for f in run.findings if f.code in (HELD, LEFT_OUT, MOVED))
    return CarriedObjects(len(table.carriers), free, right, bool(run.report["passed"]), problems)


def summarized(results: Sequence[CarriedObjects]) -> int:
    """Print how many scenes and objects are right; 1 if fewer than 80 % of the scenes are."""
    right, silent = sum(r.is_right for r in results), sum(r.passed and not r.is_right for r in results)
    objects = sum(r.true for r in results), sum(r.right for r in results)
    print(f"right: {right} of {len(results)} scenes, {objects[1]} of {objects[0]} objects; wrong and passed: {silent}")
    return 0 if right >= 0.8 * len(results) else 1


def carrier_table(seed: int) -> CarrierTable:
    """The table of a seed: one on which enough of every object is visible."""
    for attempt in range(60):
        rng = np.random.default_rng((seed, attempt))
        kind = KINDS[seed % len(KINDS)]
        objects, carriers = _objects(kind(rng), rng)
        surroundings = (tables._table(rng), tables._object("floor", Pose.of((0, 0, -0.7)), [_slab(8, 8)], True))
        scene = Scene("carriers", gravity=frozen_array([0, 0, -9.81]), objects=(*surroundings, *objects))
        camera, sensor = tables._camera(rng), sorted(SENSORS)[int(rng.integers(len(SENSORS)))]
        ray = raycast(scene, camera)
        truth = np.where(ray.objects > 2, ray.objects - 2, 0).astype(np.int32)
        if tables._countable(scene, 2, ray, truth):
            frame = replace(simulate_frame(ray, rng, SENSORS[sensor]), instances=truth)
            return CarrierTable(seed, kind.__name__.strip("_"), scene, camera, sensor, frame, carriers)
    raise RuntimeError(f"no countable table was drawn from seed {seed}")


def _objects(carrier: Carrier, rng: Rng) -> tuple[list[SceneObject], dict[str, str]]:
    """The carrier with one or two objects on it, and one beside it; and what each of them stands on."""
    turn = quat_from_rpy(0, 0, float(rng.uniform(-math.pi, math.pi)))
    X_WC = Pose.of((*rng.uniform(-0.06, 0.06, 2), 0.0), turn)
    out, on = [tables._object("carrier", X_WC, carrier.parts, False)], {"carrier": "table"}
    taken: list[tuple[Array, float]] = []
    for _ in range(40):
        parts, radius = _small(rng, min(carrier.room))
        slack = np.array(carrier.room) - radius
        if len(taken) == 2 or (slack < 0).any():
            continue
        at = rng.uniform(-slack, slack)
        if any(float(np.linalg.norm(at - other)) < radius + reach + 0.008 for other, reach in taken):
            continue
        taken.append((at, radius))
        name = f"carried_{len(taken)}"
        yaw = Pose.of((*at, carrier.floor), quat_from_rpy(0, 0, float(rng.uniform(-math.pi, math.pi))))
        out.append(tables._object(name, X_WC @ yaw, parts, False))
        on[name] = "carrier"
        if rng.random() < 0.4:
            break
    parts, radius = _small(rng, 0.05)
    side = np.array([float(rng.uniform(-0.1, 0.1)), float(rng.choice([-0.24, 0.24]))])
    out.append(tables._object("beside", Pose.of((*(X_WC.p[:2] + side), 0.0)), parts, False))
    return out, on | {"beside": "table"}


def _small(rng: Rng, room: float) -> tuple[Parts, float]:
    """A can, a ball or a block that fits into a circle of radius ``room`` [m], and its own radius."""
    most = min(0.045, room)
    radius = float(rng.uniform(0.5, 0.95)) * most if most > 0.04 else 0.9 * most
    tone, kind = tables._tone(rng), int(rng.integers(3))
    if kind == 0:
        height = float(rng.uniform(0.05, 0.12))
        return [(Cylinder(radius, height), Pose.of((0, 0, height / 2)), tone)], radius
    if kind == 1:
        return [(Sphere(radius), Pose.of((0, 0, radius)), tone)], radius
    side, height = radius * math.sqrt(2) * 0.98, float(rng.uniform(0.04, 0.1))
    return [(tables._box(side, side, height), Pose.of((0, 0, height / 2)), tone)], radius


def _slab(x: float, y: float) -> tuple[Geometry, Pose, Array]:
    return Box(frozen_array([x, y, 0.02])), Pose.of(), frozen_array([0.4, 0.4, 0.4, 1.0])


def _walled(rng: Rng, kind: str, sides: tuple[float, float], height: float, wall: float) -> Carrier:
    """An open box with walls."""
    (x, y), color = sides, tables._tone(rng)
    parts: Parts = [(tables._box(x, y, wall), Pose.of((0, 0, wall / 2)), color)]
    for sign in (-1.0, 1.0):
        parts.append((tables._box(wall, y, height), Pose.of((sign * (x - wall) / 2, 0, height / 2)), color))
        parts.append((tables._box(x, wall, height), Pose.of((0, sign * (y - wall) / 2, height / 2)), color))
    return Carrier(kind, parts, wall, (x / 2 - wall, y / 2 - wall))


def _tray(rng: Rng) -> Carrier:
    sides = float(rng.uniform(0.2, 0.28)), float(rng.uniform(0.16, 0.22))
    return _walled(rng, "tray", sides, float(rng.uniform(0.02, 0.035)), 0.006)


def _open_box(rng: Rng) -> Carrier:
    sides = float(rng.uniform(0.2, 0.28)), float(rng.uniform(0.18, 0.24))
    return _walled(rng, "open_box", sides, float(rng.uniform(0.05, 0.09)), 0.006)


def _bowl(rng: Rng) -> Carrier:
    top, height = float(rng.uniform(0.08, 0.11)), float(rng.uniform(0.04, 0.06))
    room = (0.7 * top - 0.004) / math.sqrt(2)
    return Carrier("bowl", [tables._vessel(0.7 * top, top, height, tables._tone(rng))], 0.004, (room, room))


def _plate(rng: Rng) -> Carrier:
    top = float(rng.uniform(0.09, 0.12))
    room = (0.75 * top - 0.004) / math.sqrt(2)
    return Carrier("plate", [tables._vessel(0.75 * top, top, 0.02, tables._tone(rng))], 0.004, (room, room))


def _book(rng: Rng) -> Carrier:
    x, y, z = (float(v) for v in rng.uniform((0.18, 0.13, 0.02), (0.26, 0.2, 0.05)))
    return Carrier("book", [(tables._box(x, y, z), Pose.of((0, 0, z / 2)), tables._tone(rng))], z, (x / 2, y / 2))


def _box(rng: Rng) -> Carrier:
    x, y, z = (float(v) for v in rng.uniform((0.16, 0.13, 0.07), (0.24, 0.2, 0.14)))
    return Carrier("box", [(tables._box(x, y, z), Pose.of((0, 0, z / 2)), tables._tone(rng))], z, (x / 2, y / 2))


KINDS: tuple[Callable[[Rng], Carrier], ...] = (_tray, _open_box, _bowl, _plate, _book, _box)


if __name__ == "__main__":
    sys.exit(main())
