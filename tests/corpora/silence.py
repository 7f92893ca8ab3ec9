"""Damaged captures must not pass in silence: ``python -m tests.corpora.silence [N] [--first SEED]``.

Each capture is a synthetic table whose truth is known, damaged in one way of `tests.corpora.damages`, and undamaged
ones are mixed in; with ``--unseen``, in further ways, those of `tests.corpora.attacks` among them. A capture that
passes without a finding must have its number of objects within one, an F1 at 1 cm of at least 0.5 and the right
support; anything else must be a finding or an error. Prints a line for each, and exits with 1 if one is wrong in
silence or ends with a traceback.

``--light`` reads, finds the support, segments and looks for doubts as the command does, but fits no solids, which
takes a tenth of the time. Visible surfaces are then compared instead of solids. It misses the doubts that fitting and
settling add, and the errors.
"""

from __future__ import annotations

import argparse
import resource
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.optimize import linear_sum_assignment

from simfoundry.capture.accuracy.scene_accuracy import compare, surface_distance
from simfoundry.capture.doubts.image_doubts import image_doubts
from simfoundry.capture.findings import CaptureFinding
from simfoundry.capture.frame import CaptureError
from simfoundry.capture.frames.load import load_frame, open_capture
from simfoundry.capture.run import CaptureRun, run_capture
from simfoundry.capture.segment.decompose import decompose
from simfoundry.capture.segment.find_support import find_support
from simfoundry.capture.segment.masks import thinned
from simfoundry.capture.synthesize import write_capture
from simfoundry.errors import SimfoundryError
from simfoundry.geometry.frames import Array, Pose
from simfoundry.scene.lower import lower_file
from simfoundry.spec.diagnostics import SpecError
from simfoundry.spec.models.capture import CaptureSpec, Shot
from simfoundry.spec.yaml.write import to_yaml
from tests.corpora.attacks import ATTACKS
from tests.corpora.damages import DAMAGES, UNSEEN, Damaged
from tests.corpora.odd_damages import ODD
from tests.corpora.synthetic_tables import SyntheticTable, synthetic_table

ALL = DAMAGES | UNSEEN | ATTACKS | ODD
MIN_F1 = 0.5
MAX_OFF = 1
MAX_SUPPORT_HEIGHT, MAX_SUPPORT_TILT_DEG = 0.02, 3.0
"""How far off [m], [deg] the support may be: a glass less, and it is another surface."""


@dataclass(frozen=True)
class Outcome:
    """The end of one capture: passed, doubted or refused, its codes, and why passing was wrong, if it was."""

    name: str
    damage: str
    end: str
    codes: tuple[str, ...]
    wrong: str
    seconds: float


def outcome(seed: int, damage: str, folder: Path, light: bool) -> Outcome:
    """Damage the table of a seed, reconstruct it, and compare what passes with the truth."""
    table = synthetic_table(seed)
    damaged = ALL[damage](table, np.random.default_rng((seed, 77)))
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
        findings, errors = (_segmented if light else _reconstructed)(table, damaged, capture)
        codes = tuple(sorted({f.code for f in findings}))
        end = "doubted" if findings else "passed"
        if end == "passed":
            wrong = errors
        elif not errors:
            end = "doubted, though right"
    except CaptureError as error:
        end, codes = "refused", (error.code,)
    except SpecError as error:
        end, codes = "refused", tuple(f.code for f in error.diagnostics)
    except SimfoundryError as error:
        end, codes = "refused", (type(error).__name__,)
    except Exception:
        end, wrong = "traceback", traceback.format_exc(limit=-2).replace("\n", " / ")
    return Outcome(f"seed {seed}", damage, end, codes, wrong, time.perf_counter() - start)


def _reconstructed(table: SyntheticTable, damaged: Damaged, capture: Path) -> tuple[Sequence[CaptureFinding], str]:
    """The findings of the whole command, and what is wrong with its scene."""
    run = run_capture(capture, capture.parent / "out")
    return run.findings, _errors(table, damaged, run)


def _segmented(table: SyntheticTable, damaged: Damaged, capture: Path) -> tuple[Sequence[CaptureFinding], str]:
    """The findings about the image and its segments, and what is wrong with these.

    Raises:
        CaptureError: The image is refused.
    """
    frame = load_frame(open_capture(capture))
    support = find_support(frame)
    segmentation = decompose(frame, support)
    findings = (*frame.findings, *image_doubts(frame, support, segmentation))
    found = [segmentation.labels == k for k in np.unique(segmentation.labels[segmentation.labels > 0])]
    if abs(len(found) - damaged.count) > MAX_OFF:
        return findings, f"{len(found)} objects instead of {damaged.count}"
    if fault := _support_fault(table.camera.X_WC @ damaged.X_camera, support.X_WC):
        return findings, fault
    points = damaged.X_camera.inverse().apply(table.frame.points)
    true = [_sample(points[table.truth == k]) for k in np.unique(table.truth[table.truth > 0])]
    seen = [_sample(frame.points[mask]) for mask in found]
    scores = np.array([[surface_distance(a, b)[1] if len(a) and len(b) else 0.0 for b in seen] for a in true])
    rows, columns = linear_sum_assignment(-scores)
    return findings, _f1_fault(scores[rows, columns].tolist(), damaged)


def _sample(points: Array) -> Array:
    """At most 400 to 800 of the points that were measured."""
    return thinned(points[np.isfinite(points).all(axis=1)], 400)


def _errors(table: SyntheticTable, damaged: Damaged, run: CaptureRun) -> str:
    """What is wrong with a scene, or an empty string."""
    scene = lower_file(run.scene_file)
    found = len([o for o in scene.objects if o.name != "table"])
    if abs(found - damaged.count) > MAX_OFF:
        return f"{found} objects instead of {damaged.count}"
    camera = replace(table.camera, X_WC=table.camera.X_WC @ damaged.X_camera)
    if fault := _support_fault(camera.X_WC, scene.cameras[0].X_WC):
        return fault
    compared = compare(table.scene, camera, scene, scene.cameras[0])
    return _f1_fault([0.0 if np.isnan(c.f1) else c.f1 for c in compared], damaged)


def _support_fault(X_true: Pose, X_found: Pose) -> str:
    """How far off the support is, seen from the camera, or an empty string."""
    tilt = np.degrees(np.arccos(np.clip(X_found.rotation[2] @ X_true.rotation[2], -1, 1)))
    height = float(X_found.p[2] - X_true.p[2])
    if abs(height) > MAX_SUPPORT_HEIGHT or tilt > MAX_SUPPORT_TILT_DEG:
        return f"the support is {height * 100:+.1f} cm and {tilt:.1f} deg off"
    return ""


def _f1_fault(scores: Sequence[float], damaged: Damaged) -> str:
    """The mean F1 score of the best objects, as many as are visible, if it is low, or an empty string."""
    best = sorted(scores, reverse=True)[: max(1, damaged.count)]
    f1 = float(np.mean(best)) if best else 0.0
    return f"an F1 of {f1:.2f}" if f1 < MIN_F1 else ""


def main() -> int:
    """Run them all; returns the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("count", type=int, nargs="?", default=300, help="number of captures")
    parser.add_argument("--first", type=int, default=0, metavar="SEED", help="seed of the first one")
    parser.add_argument("--only", choices=sorted(ALL), help="one kind of damage")
    parser.add_argument("--unseen", action="store_true", help="kinds of damage that most checks were not made for")
    parser.add_argument("--light", action="store_true", help="segment without fitting solids")
    options = parser.parse_args()
    kinds = [options.only] if options.only else list(UNSEEN | ATTACKS | ODD if options.unseen else DAMAGES)
    outcomes = []
    for k in range(options.count):
        with tempfile.TemporaryDirectory(prefix="simfoundry-silence-") as folder:
            found = outcome(options.first + k, kinds[k % len(kinds)], Path(folder), options.light)
        outcomes.append(found)
        line = f"{found.name:9} {found.damage:16} {found.end:21} {found.seconds:5.1f} s  {' '.join(found.codes)}"
        print(f"{line}  {'WRONG: ' + found.wrong if found.wrong else ''}".rstrip(), flush=True)
    for kind in kinds:
        ends = Counter(o.end for o in outcomes if o.damage == kind)
        print(f"{kind:16} {', '.join(f'{n} {end}' for end, n in sorted(ends.items()))}")
    wrong = sum(bool(o.wrong) for o in outcomes)
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"{wrong} of {len(outcomes)} wrong in silence; at most {memory:.0f} MB of memory")
    return 1 if wrong else 0


if __name__ == "__main__":
    raise SystemExit(main())
