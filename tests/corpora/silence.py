"""Damaged captures must not pass in silence: ``python -m tests.corpora.silence [N] [--first SEED]``.

Each capture is a synthetic table whose truth is known, damaged in one way: wrong scale, noise, color that is offset
against depth, a crop, an object of glass, no table, wrong intrinsics, files that are missing or cut short. Undamaged
ones are mixed in. A capture that passes without a finding must have its number of objects within one, an F1 at 1 cm of
at least 0.5 and the right support; anything else must be a finding or an error. Prints a line for each, and exits with
1 if one is wrong in silence or ends with a traceback.
"""

from __future__ import annotations

import argparse
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from simfoundry.capture.accuracy import compare
from simfoundry.capture.frame import Frame
from simfoundry.capture.run import CaptureRun, run_capture
from simfoundry.capture.synthesize import write_capture
from simfoundry.errors import SimfoundryError
from simfoundry.scene.lower import lower_file
from simfoundry.spec.diagnostics import SpecError
from simfoundry.spec.models.capture import CaptureSpec, Shot
from simfoundry.spec.yaml.write import to_yaml
from tests.corpora.synthetic_tables import PIXELS, SyntheticTable, synthetic_table

Rng = np.random.Generator
MIN_F1 = 0.5
MAX_OFF = 1
MAX_SUPPORT_HEIGHT, MAX_SUPPORT_TILT_DEG = 0.02, 3.0
"""How far off [m], [deg] the support may be: a glass less, and it is another surface."""


@dataclass(frozen=True, eq=False)
class Damaged:
    """A damaged picture, the unit of its depth as stated [m], and the number of objects in it."""

    frame: Frame
    count: int
    scale: float = 1e-4
    spoil: Callable[[Path], None] = lambda folder: None


@dataclass(frozen=True)
class Outcome:
    """The end of one capture: passed, doubted or refused, its codes, and why passing was wrong, if it was."""

    name: str
    damage: str
    end: str
    codes: tuple[str, ...]
    wrong: str
    seconds: float


def _scaled(table: SyntheticTable, rng: Rng) -> Damaged:
    factor = float(rng.choice([0.1, 0.4, 0.5, 2.0, 2.5, 10.0]))
    return Damaged(table.frame, table.count, 1e-4 * factor)


def _noisy(table: SyntheticTable, rng: Rng) -> Damaged:
    noise = rng.normal(size=table.frame.depth.shape) * float(rng.uniform(0.004, 0.03))
    return Damaged(replace(table.frame, depth=table.frame.depth + noise), table.count)


def _offset(table: SyntheticTable, rng: Rng) -> Damaged:
    turn, length = rng.uniform(0, 2 * np.pi), rng.uniform(8, 40)
    shift = round(length * np.sin(turn)), round(length * np.cos(turn))
    return Damaged(replace(table.frame, color=np.roll(table.frame.color, shift, axis=(0, 1))), table.count)


def _cropped(table: SyntheticTable, rng: Rng) -> Damaged:
    h, w = table.truth.shape
    height, width = int(h * rng.uniform(0.4, 0.8)), int(w * rng.uniform(0.4, 0.8))
    top, left = int(rng.integers(h - height)), int(rng.integers(w - width))
    part = np.s_[top : top + height, left : left + width]
    K = table.frame.K - np.array([[0, 0, left], [0, 0, top], [0, 0, 0]])
    frame = Frame(np.ascontiguousarray(table.frame.color[part]), table.frame.depth[part].copy(), K)
    return Damaged(frame, _visible(table.truth[part]))


def _glass(table: SyntheticTable, rng: Rng) -> Damaged:
    """Without the depth of one object, or with a tenth of it."""
    mask = table.truth == int(rng.integers(1, int(table.truth.max()) + 1))
    lost = mask & (rng.random(mask.shape) < rng.choice([1.0, 0.9]))
    return Damaged(replace(table.frame, depth=np.where(lost, np.nan, table.frame.depth)), table.count)


def _no_table(table: SyntheticTable, _: Rng) -> Damaged:
    """Only the objects have depth."""
    mask = table.truth > 0
    return Damaged(replace(table.frame, depth=np.where(mask, table.frame.depth, np.nan)), table.count)


def _wrong_intrinsics(table: SyntheticTable, rng: Rng) -> Damaged:
    K = table.frame.K.copy()
    if rng.random() < 0.6:
        K[:2, :2] *= float(rng.choice([0.5, 0.7, 1.4, 2.0]))
    else:
        K[:2, 2] += rng.choice([-1, 1], 2) * rng.uniform(100, 220, 2)
    return Damaged(replace(table.frame, K=K), table.count)


def _missing(table: SyntheticTable, rng: Rng) -> Damaged:
    name, kind = str(rng.choice(["color.png", "depth.png"])), int(rng.integers(3))

    def spoil(folder: Path) -> None:
        file = folder / name
        data = file.read_bytes()
        if kind == 0:
            file.unlink()
        else:
            file.write_bytes(data[: len(data) // 2] if kind == 1 else b"")

    return Damaged(table.frame, table.count, spoil=spoil)


def _nothing(table: SyntheticTable, _: Rng) -> Damaged:
    return Damaged(table.frame, table.count)


DAMAGES: dict[str, Callable[[SyntheticTable, Rng], Damaged]] = {
    "scale": _scaled,
    "noise": _noisy,
    "offset": _offset,
    "crop": _cropped,
    "glass": _glass,
    "no table": _no_table,
    "intrinsics": _wrong_intrinsics,
    "missing": _missing,
    "none": _nothing,
}


def _visible(truth: NDArray[np.int32]) -> int:
    return int((np.bincount(truth[truth > 0], minlength=1) >= PIXELS).sum())


def outcome(seed: int, damage: str, folder: Path) -> Outcome:
    """Damage the table of a seed, reconstruct it, and compare what passes with the truth."""
    table = synthetic_table(seed)
    rng = np.random.default_rng((seed, 77))
    damaged = DAMAGES[damage](table, rng)
    capture = folder / "capture"
    shot = write_capture(capture, damaged.frame)
    assert shot.depth is not None
    shot = Shot(color=shot.color, depth=shot.depth.model_copy(update={"scale": damaged.scale}), camera=shot.camera)
    document = CaptureSpec(simfoundry="capture/1", name="table", frames={"first": shot})
    (capture / "capture.yaml").write_text(to_yaml(document))
    damaged.spoil(capture)
    start = time.perf_counter()
    codes: tuple[str, ...] = ()
    wrong = ""
    try:
        run = run_capture(capture, folder / "out")
        codes = tuple(sorted({f.code for f in run.findings}))
        end = "doubted" if run.findings else "passed"
        errors = _errors(table, damaged, run)
        if end == "passed":
            wrong = errors
        elif not errors:
            end = "doubted, though right"
    except SpecError as error:
        end, codes = "refused", tuple(f.code for f in error.diagnostics)
    except SimfoundryError as error:
        end, codes = "refused", (type(error).__name__,)
    except Exception:
        end, wrong = "traceback", traceback.format_exc(limit=-2).replace("\n", " / ")
    return Outcome(f"seed {seed}", damage, end, codes, wrong, time.perf_counter() - start)


def _errors(table: SyntheticTable, damaged: Damaged, run: CaptureRun) -> str:
    """What is wrong with a scene, or an empty string."""
    scene = lower_file(run.scene_file)
    found = len([o for o in scene.objects if o.name != "table"])
    if abs(found - damaged.count) > MAX_OFF:
        return f"{found} objects instead of {damaged.count}"
    X_true = table.camera.X_WC
    X_found = scene.cameras[0].X_WC
    tilt = np.degrees(np.arccos(np.clip(X_found.rotation[2] @ X_true.rotation[2], -1, 1)))
    height = float(X_found.p[2] - X_true.p[2])
    if abs(height) > MAX_SUPPORT_HEIGHT or tilt > MAX_SUPPORT_TILT_DEG:
        return f"the support is {height * 100:+.1f} cm and {tilt:.1f} deg off"
    scores = [0.0 if np.isnan(c.f1) else c.f1 for c in compare(table.scene, table.camera, scene, scene.cameras[0])]
    best = sorted(scores, reverse=True)[: max(1, damaged.count)]
    f1 = float(np.mean(best)) if best else 0.0
    return f"an F1 of {f1:.2f}" if f1 < MIN_F1 else ""


def main() -> int:
    """Run them all; returns the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("count", type=int, nargs="?", default=300, help="number of captures")
    parser.add_argument("--first", type=int, default=0, metavar="SEED", help="seed of the first one")
    parser.add_argument("--only", choices=sorted(DAMAGES), help="one kind of damage")
    options = parser.parse_args()
    kinds = [options.only] if options.only else list(DAMAGES)
    outcomes = []
    for k in range(options.count):
        with tempfile.TemporaryDirectory(prefix="simfoundry-silence-") as folder:
            found = outcome(options.first + k, kinds[k % len(kinds)], Path(folder))
        outcomes.append(found)
        line = f"{found.name:9} {found.damage:10} {found.end:21} {found.seconds:5.1f} s  {' '.join(found.codes)}"
        print(f"{line}  {'WRONG: ' + found.wrong if found.wrong else ''}".rstrip(), flush=True)
    for kind in kinds:
        ends = Counter(o.end for o in outcomes if o.damage == kind)
        print(f"{kind:10} {', '.join(f'{n} {end}' for end, n in sorted(ends.items()))}")
    wrong = sum(bool(o.wrong) for o in outcomes)
    print(f"{wrong} of {len(outcomes)} wrong in silence")
    return 1 if wrong else 0


if __name__ == "__main__":
    raise SystemExit(main())
