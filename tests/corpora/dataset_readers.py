"""Load datasets with their real readers: ``python -m tests.corpora.dataset_readers --environments DIR [--create]``.

Demonstrations of a small task are recorded and built in every format. Each reader, in a virtual environment of its own,
loads every frame and compares it with the values and images from which the dataset was built. LeRobot also writes
datasets, which SimFoundry reads. DIR contains an environment for each reader; ``--create`` makes missing ones,
which takes 12 GB. Prints a table of checks, each with its worst figure; exits with 1 if one fails.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

import simfoundry as sf
from simfoundry.data.dataset.build import build_dataset
from simfoundry.data.dataset.episode import Episode
from simfoundry.data.dataset.episodes import EpisodeBuilder
from simfoundry.data.dataset.features import DatasetInfo
from simfoundry.data.dataset.formats import dataset_format
from simfoundry.data.dataset.plan import DatasetPlan, plan_dataset
from simfoundry.data.dataset.statistics import FeatureStatistics, sampled_frames
from simfoundry.spec.models.dataset import DatasetSpec
from tests.corpora.readers.comparison import Expected, Report, psnr
from tests.corpora.readers.environments import ENVIRONMENTS, create, python_of
from tests.corpora.record import SCENE, TASK

CAMERAS = """\
cameras:
  front: {size: [640, 360], fx: 500, fy: 500, pose: {xyz: [1.3, 0.2, 0.7], look_at: [0.4, 0, 0]}}
  wrist: {size: [640, 360], fx: 400, fy: 400, pose: {xyz: [0.05, 0, -0.05], look_at: [0, 0, 0.2]}, mount: arm.hand}
"""

# The dataset with every kind of feature, and those that profiles describe.
HEAD = {"simfoundry": "dataset/1", "sources": {"expert": {"demonstrations": "demos"}}}
EVERYTHING: dict[str, Any] = {
    **HEAD,
    "name": "stack",
    "cameras": {
        "observation.images.front": {"camera": "front", "size": [320, 180]},
        "observation.images.wrist": {"camera": "wrist", "size": [160, 120]},
        "observation.depth.front": {"camera": "front", "size": [64, 36], "kind": "depth"},
        "observation.images.front_mask": {"camera": "front", "size": [64, 36], "kind": "mask"},
    },
    "state": {"observation.state": ["joints", "gripper"], "observation.environment_state": ["objects"]},
    "fps": 5,
    "splits": {"train": {"until": 0.75}, "held_out": {"from": 0.75}},
}
PROFILES = {
    "openpi-droid": "lerobot-v2.1",
    "gr00t": "lerobot-v2.1",
    "lerobot": "lerobot-v3",
    "robomimic": "robomimic",
    "rlds-droid": "rlds",
}


def main() -> int:
    """Run the proof; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--environments", type=Path, required=True)
    parser.add_argument("--create", action="store_true")
    parser.add_argument("--only", action="append", choices=ENVIRONMENTS, help="an environment to use; default: all")
    parser.add_argument("--count", type=int, default=4, help="number of demonstrations")
    options = parser.parse_args()
    names = options.only or list(ENVIRONMENTS)
    if options.create:
        for name in names:
            create(options.environments / name, ENVIRONMENTS[name])
    missing = [name for name in names if not python_of(options.environments, name).exists()]
    if missing:
        print(f"{options.environments} lacks {', '.join(missing)}; make them with --create")
        return 2
    with tempfile.TemporaryDirectory(prefix="simfoundry-readers-") as temporary:
        failures = run(Path(temporary), options.environments, names, options.count)
    print("every reader returns what was written" if not failures else f"{failures} checks failed")
    return int(failures > 0)


def run(folder: Path, environments: Path, names: list[str], count: int) -> int:
    """Record, build, and load with each reader; returns the number of failed checks."""
    (folder / "cell.scene.yaml").write_text(SCENE + CAMERAS, encoding="utf-8")
    (folder / "stack.task.yaml").write_text(TASK, encoding="utf-8")
    sf.record(folder / "stack.task.yaml", out=folder / "demos", count=count, policy="expert")
    formats = list(dict.fromkeys(ENVIRONMENTS[name].format for name in names))
    places, expected = build(folder, "everything", EVERYTHING, formats)
    failures = 0
    for name in names:
        arguments = [ENVIRONMENTS[name].script, places[ENVIRONMENTS[name].format], expected]
        failures += shown("everything", called(environments, name, arguments, folder))
    for profile, form in PROFILES.items():
        if form in formats:
            spec = {**HEAD, "name": profile.replace("-", "_"), "profile": profile}
            places, wanted = build(folder, profile, spec, [form])
            name = [name for name in names if ENVIRONMENTS[name].format == form][-1]
            script = "gr00t_reader" if profile == "gr00t" else ENVIRONMENTS[name].script
            failures += shown(f"profile {profile}", called(environments, name, [script, places[form], wanted], folder))
    for name in (name for name in names if ENVIRONMENTS[name].script == "lerobot_reader"):
        written = folder / f"written-{name}"
        outcome = called(environments, name, ["lerobot_writer", expected, written], folder)
        if "checks" in outcome and written.is_dir():
            outcome["checks"] = read_back(ENVIRONMENTS[name].format, written, Expected(expected)).checks
        failures += shown("written by it, read by SimFoundry", outcome)
    return failures


def build(folder: Path, name: str, spec: dict[str, Any], formats: list[str]) -> tuple[dict[str, Path], Path]:
    """Build a dataset; returns its folder for each format, and that of what the readers are to return."""
    plan = plan_dataset(DatasetSpec.model_validate_json(json.dumps(spec)), folder, formats)
    places = dict(zip(plan.formats, build_dataset(plan, folder / name), strict=True))
    expect(folder / f"expected-{name}", plan)
    return places, folder / f"expected-{name}"


def called(environments: Path, name: str, arguments: list[Any], folder: Path) -> dict[str, Any]:
    """Run a script in an environment, and return what it printed last. Nothing is looked up on the network."""
    script, *rest = arguments
    variables = {
        **os.environ,
        "PYTHONPATH": str(Path(__file__).parents[2]),
        "HF_HUB_OFFLINE": "1",
        "HF_HOME": str(folder / f"cache-{name}"),
    }
    command = [str(python_of(environments, name)), "-m", f"tests.corpora.readers.{script}", *map(str, rest)]
    done = subprocess.run(command, env=variables, capture_output=True, text=True, check=False)
    lines = done.stdout.strip().splitlines()
    if done.returncode or not lines:
        return {"reader": name, "error": done.stderr[-3000:]}
    return dict(json.loads(lines[-1]))


def shown(dataset: str, outcome: dict[str, Any]) -> int:
    """Print the outcome of a reader, and return the number of failed checks."""
    if "error" in outcome:
        print(f"FAIL {outcome['reader']}, {dataset}:\n{outcome['error']}", flush=True)
        return 1
    checks = outcome["checks"]
    failed = {name: one for name, one in checks.items() if not one["ok"]}
    comparisons = sum(one["count"] for one in checks.values())
    print(f"{'FAIL' if failed or not checks else 'ok  '} {outcome['reader']}, {dataset}:", end=" ")
    print(f"{len(checks)} checks with {comparisons} comparisons", end="")
    for name, one in checks.items():
        if one["measure"] == "min":
            print(f"; {name} ≥ {one['figure']:.1f}", end="")
    worst = max((one["figure"] for one in checks.values() if one["measure"] == "max error"), default=0.0)
    print(f"; largest other difference {worst:.1g}", flush=True)
    for name, one in failed.items():
        print(f"     {name}: {one['measure']} {one['figure']}", flush=True)
    return len(failed) or int(not checks)


def expect(folder: Path, plan: DatasetPlan) -> None:
    """Write what the readers are to return: arrays in NumPy's own format, and JSON. The formats have no part in it."""
    folder.mkdir(parents=True)
    builder, headers = EpisodeBuilder.of(plan), []
    rows: dict[str, list[Any]] = {feature.name: [] for feature in plan.info.features}
    try:
        for planned in plan.episodes:
            episode = builder.build(planned)
            values = episode_values(plan.info, episode)
            chosen = sorted(sampled_frames(episode.header.length))
            for feature in plan.info.features:
                rows[feature.name].append(values[feature.name][chosen] if feature.is_image else values[feature.name])
            np.savez(folder / f"{episode.header.index:06d}.npz", **values)
            one = episode.header
            headers.append({"length": one.length, "instruction": one.instruction, "split": one.split})
    finally:
        builder.close()
    about = {
        "fps": plan.info.fps,
        "features": dict(described(plan.info)),
        "splits": {name: list(ends) for name, ends in plan.info.splits.items()},
        "episodes": headers,
        "statistics": {f.name: statistics(np.concatenate(rows[f.name]), f.is_image) for f in plan.info.features},
    }
    (folder / "expected.json").write_text(json.dumps(about), encoding="utf-8")


def episode_values(info: DatasetInfo, episode: Episode) -> dict[str, Any]:
    """Return the values of an episode by name."""
    values: dict[str, Any] = {"rewards": episode.rewards, "dones": episode.dones, "states": episode.states}
    values |= dict(episode.arrays) | {f"final/{name}": one for name, one in episode.final.items()}
    frames = list(episode.frames(final=True))
    for feature in info.images:
        images = np.stack([frame[feature.name] for frame in frames])
        values |= {feature.name: images[:-1], f"final/{feature.name}": images[-1]}
    if episode.generation is not None:
        parts = {"eef": "eef_pose", "target": "target_pose", "object": "object_poses", "signal": "subtask_term_signals"}
        for kind, part in parts.items():
            named = getattr(episode.generation, part)
            values |= {f"generation/{kind}/{name}": one for name, one in named.items()}
    return values


def described(info: DatasetInfo) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield what the readers need to know of each feature."""
    for f in info.features:
        kind = f.kind.value if f.image is None or f.image.value == "image" else f.image.value
        parts = [[part.name, part.start, part.stop] for part in f.parts]
        yield f.name, {"kind": kind, "role": f.role.value, "shape": f.shape, "parts": parts}


def statistics(values: Any, is_image: bool) -> dict[str, Any]:
    """Return statistics by NumPy, those of images over the frames that SimFoundry counts."""
    rows = values.reshape(-1, values.shape[-1]) if is_image else values
    one = FeatureStatistics.of(rows)
    numbers = {key: getattr(one, key).tolist() for key in ("min", "max", "mean", "std")}
    return numbers | {"count": [len(values)], **{key: value.tolist() for key, value in one.quantiles.items()}}


def read_back(form: str, folder: Path, expected: Expected) -> Report:
    """Read a dataset that LeRobot wrote, and compare it with what LeRobot was given."""
    report, stored = Report(), dataset_format(form).read(folder)
    report.equal("episodes", len(stored), len(expected.episodes))
    for k, about in enumerate(expected.episodes):
        episode, values = stored.episode(k), expected.values(k)
        report.equal("task", episode.header.instruction, about["instruction"])
        for name in expected.names("array"):
            report.equal(name, episode.arrays[name], values[name])
        for t, images in enumerate(episode.frames()):
            for name in expected.names("image"):
                report.equal(name, images[name], values[name][t])
            for name in expected.names("video"):
                report.at_least(f"{name} [dB]", psnr(images[name], values[name][t]), 26.0)
    for name in expected.names("array"):
        report.close("statistics: mean", stored.statistics[name].mean, expected.statistics[name]["mean"], 1e-5)
    return report


if __name__ == "__main__":
    sys.exit(main())
