"""MJCF scenes with actuators to documents and back: ``python -m tests.corpora.mjcf_scenes FOLDER``.

Each file below the folder that MuJoCo loads and that has actuators is imported, compiled to MJCF and compared with the
original: the numbers of bodies, joints, actuators, sensors, sites, tendons and equalities, and one second of motion
under the same random controls. Both start in their first keyframe, or in their initial state. The controls are seeded,
within their ranges, and constant for 0.1 s; controls without a range are within [-1, 1]. Every body is compared by
position and rotation every 10 ms.

Contacts can amplify rounding errors. Therefore, the table also lists how far the original moves away from itself if
its first state is changed by 1e-15 to 1e-10; this does not change the bar. Scenes that MuJoCo resets because they
become unstable amplify even more. Exit code 1 if fewer than nine of ten files pass.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.corpora.importing.files import Job, jobs_below, sampled

COUNTS = ("body", "jnt", "u", "sensor", "site", "tendon", "eq")
"""What is counted: the fields of a model without their ``n``."""

POSITION, ANGLE = 1e-3, 0.1
"""The largest differences of a body [m] and [deg]."""

SECONDS, HOLD, EVERY = 1.0, 0.1, 0.01
"""How long the scenes move, how long a control is held, and how often bodies are compared [s]."""

NUDGES = (1e-15, 1e-12, 1e-10)
"""Changes of all positions in the first state of the original [m or rad]."""

LIMIT = 300
"""The time for one file [s]; meshes may have to be read and hulls computed."""

SHARE = 0.9
"""The share of files that must pass."""


def measure(path: Path) -> dict[str, Any]:
    """Import, compile and compare one file."""
    import mujoco

    from simfoundry.errors import SimfoundryError
    from simfoundry.frontends.draft import ImportOptions
    from simfoundry.frontends.importer import import_file
    from simfoundry.scene.lower import lower_file
    from simfoundry.spec.diagnostics import SpecError
    from simfoundry.targets.build import build

    a = mujoco.MjModel.from_xml_path(str(path))
    out: dict[str, Any] = {"before": counts(a)}
    with tempfile.TemporaryDirectory() as folder:
        document = Path(folder) / "thing.scene.yaml"
        try:
            report = import_file(path, document, ImportOptions())
            build(lower_file(document), ["mjcf"], Path(folder))
            b = mujoco.MjModel.from_xml_path(str(Path(folder) / "mjcf/scene.xml"))
        except (SimfoundryError, SpecError, ValueError) as error:
            return out | {"reason": " ".join(str(error).replace(str(path), "").split())[:200]}
        out |= {"after": counts(b), "notes": [f"{n.what}: {n.why}" for n in report.notes if n.kind == "dropped"][:5]}
    lost = [n for n, x, y in zip(COUNTS, out["before"], out["after"], strict=True) if x != y]
    if lost:
        out["reason"] = f"another number of {', '.join(lost)}"
    if out["before"][:3] != out["after"][:3] or a.nq != b.nq:
        return out
    first, again, *nudged = (
        trajectory(model, nudge) for model, nudge in ((a, 0.0), (b, 0.0), *((a, n) for n in NUDGES))
    )
    out |= dict(zip(("position", "angle"), apart(first, again), strict=True))
    own = [apart(first, each) for each in nudged]
    out |= {"own_position": max(p for p, _ in own), "own_angle": max(angle for _, angle in own)}
    if not (out["position"] <= POSITION and out["angle"] <= ANGLE):
        chaotic = out["own_position"] > POSITION or out["own_angle"] > ANGLE
        why = ", as the original does if nudged" if chaotic else ", unstable: MuJoCo resets it" if is_reset(a) else ""
        if a.nflex > b.nflex:
            why = f": {a.nflex} flex of the original is not imported"
        out.setdefault("reason", f"moves differently{why}")
    return out


def is_reset(model: Any) -> bool:
    """Whether MuJoCo resets the scene because its accelerations are too large."""
    import mujoco

    data = mujoco.MjData(model)
    data.ctrl[:] = np.where(model.actuator_ctrllimited[: model.nu], model.actuator_ctrlrange[: model.nu, 1], 1.0)
    for _ in range(round(SECONDS / float(model.opt.timestep))):
        mujoco.mj_step(model, data)
    return bool(data.warning[int(mujoco.mjtWarning.mjWARN_BADQACC)].number) or data.time < 0.9 * SECONDS


def counts(model: Any) -> list[int]:
    """The numbers of elements of a model, in the order of :data:`COUNTS`."""
    return [int(getattr(model, f"n{name}")) for name in COUNTS]


def trajectory(model: Any, nudge: float) -> NDArray[np.float64]:
    """The poses of all bodies but the world at each time, shape (times, bodies, 7), quaternions wxyz."""
    import mujoco

    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    data.qpos += nudge
    rng = np.random.default_rng(0)
    limited = model.actuator_ctrllimited.astype(bool)[: model.nu]
    ranges = np.where(limited[:, None], model.actuator_ctrlrange[: model.nu], (-1.0, 1.0))
    controls = rng.uniform(ranges[:, 0], ranges[:, 1], (round(SECONDS / HOLD), model.nu))
    step = float(model.opt.timestep)
    every, poses = max(1, round(EVERY / step)), []
    for k in range(round(SECONDS / step)):
        data.ctrl[:] = controls[min(int(k * step / HOLD + 1e-9), len(controls) - 1)]
        mujoco.mj_step(model, data)
        if k % every == 0:
            poses.append(np.hstack([data.xpos[1:], data.xquat[1:]]))
    return np.array(poses)


def apart(a: NDArray[np.float64], b: NDArray[np.float64]) -> tuple[float, float]:
    """The largest differences of two trajectories in position [m] and angle [deg]."""
    if a.shape != b.shape:
        return float("inf"), float("inf")
    position = float(np.linalg.norm(a[..., :3] - b[..., :3], axis=-1).max(initial=0.0))
    p, q = a[..., 3:], b[..., 3:]
    vectors = q[..., :1] * p[..., 1:] - p[..., :1] * q[..., 1:] - np.cross(p[..., 1:], q[..., 1:])
    angles = 2 * np.arcsin(np.clip(np.linalg.norm(vectors, axis=-1), 0.0, 1.0))
    return position, float(np.degrees(angles).max(initial=0.0))


def with_actuators(jobs: list[Job]) -> Iterator[Job]:
    """The files of different content that MuJoCo loads without plug-ins and that have actuators."""
    import mujoco

    seen = set()
    for job in jobs:
        if job.path.suffix != ".xml" or b"<mujoco" not in job.path.read_bytes()[:20_000]:
            continue
        try:
            model = mujoco.MjModel.from_xml_path(str(job.path))
        except (ValueError, mujoco.FatalError):
            continue
        key = hashlib.sha256(model.qpos0.tobytes() + model.body_mass.tobytes() + model.actuator_gainprm.tobytes())
        if model.nu and key.digest() not in seen:
            seen.add(key.digest())
            yield job


def run(job: Job) -> dict[str, Any]:
    """Measure one file in a process of its own."""
    command = [sys.executable, "-m", "tests.corpora.mjcf_scenes", "--one", str(job.path)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT, check=False)
        result: dict[str, Any] = json.loads(done.stdout.strip().splitlines()[-1])
    except subprocess.TimeoutExpired:
        return {"key": job.key, "reason": f"not finished after {LIMIT} s"}
    except (IndexError, ValueError):
        return {"key": job.key, "reason": f"broke: {done.stderr.strip().splitlines()[-1:]}"}
    return result | {"key": job.key}


def print_table(results: list[dict[str, Any]]) -> int:
    """Print a row for each file, and return how many pass."""
    print(f"counts: {', '.join(COUNTS)}")
    print("| file | counts | after | position [mm] | angle [deg] | nudged [mm] | nudged [deg] | reason |")
    print("|---|---|---|---|---|---|---|---|")
    for r in results:
        before, after = (" ".join(map(str, r.get(k, []))) for k in ("before", "after"))
        cells = [f"{1e3 * r[k]:.2g}" if k in r else "" for k in ("position", "own_position")]
        turns = [f"{r[k]:.2g}" if k in r else "" for k in ("angle", "own_angle")]
        same = "same" if before == after else after
        row = [r["key"], before, same, cells[0], turns[0], cells[1], turns[1], r.get("reason", "")]
        print(f"| {' | '.join(row)} |")
    return sum("reason" not in r for r in results)


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--one", action="store_true", help="Measure a single file and print JSON.")
    parser.add_argument("--count", type=int, default=100, help="How many files.")
    parser.add_argument("--only", default="", help="Only files whose path holds this text.")
    parser.add_argument("--workers", type=int, default=1)
    options = parser.parse_args()
    if options.one:
        print(json.dumps(measure(options.folder)))
        return 0
    jobs = sampled(with_actuators(list(jobs_below(options.folder))), options.count)
    jobs = [job for job in jobs if options.only in job.key]
    with ThreadPoolExecutor(options.workers) as threads:
        results = list(threads.map(run, jobs))
    good = print_table(results)
    print(f"{good} of {len(results)} files keep every count and move within {1e3 * POSITION:g} mm and {ANGLE:g} deg")
    return int(good < SHARE * len(results))


if __name__ == "__main__":
    sys.exit(main())
