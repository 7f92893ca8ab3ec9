"""The scripted expert on the tasks of ``specs/``: how many of 25 rollouts of the paper's protocol it wins.

    python -m tests.corpora.expert [--tasks NAME ...] [-n 25] [--world mujoco pybullet] [--videos FOLDER] [--shard 1/2]

Several engines begin from the same starts. Needs the robots' models (docs/robots.md). Exits with 1 where a task falls
short of :data:`BAR` in MuJoCo, or where an engine wins fewer by more than :data:`APART` of 25.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from simfoundry.assets.cache import Cache
from simfoundry.evaluate.expert.policy import ExpertPolicy
from simfoundry.evaluate.policies.base import Image, ImageSize
from simfoundry.evaluate.resets.starts import starts
from simfoundry.evaluate.rollouts.rollout import Video, rollout
from simfoundry.evaluate.task import load_task
from simfoundry.predicates import Judge
from simfoundry.worlds import open_world, world_names

SPECS = Path(__file__).parents[2] / "specs" / "tasks"
ROLLOUTS = 25

BAR = 20
"""How many of 25 rollouts of each task must be won in MuJoCo."""

APART = 2
"""By how many of 25 rollouts the engines may differ on a task."""


def attempt(
    name: str, engine: str, n: int, shard: tuple[int, int], videos: Path | None, cache: Cache | None
) -> tuple[int, int]:
    """Roll out one task in one engine; prints each rollout, returns how many were won and how many there were."""
    task = load_task(SPECS / f"{name}.task.yaml", cache)
    all_starts = starts(task, n, cache=cache)
    expert, judge = ExpertPolicy(task), Judge(task.scene)
    good = count = 0
    camera = next(iter(camera.name for camera in task.scene.cameras))
    video = Video({camera: ImageSize(480, 270)}, every=2) if videos is not None else None
    with open_world(task.scene, engine) as world:
        for start in all_starts[shard[0] - 1 :: shard[1]]:
            began = time.perf_counter()
            one = rollout(task, start, expert, world, judge, video)
            good, count = good + one.success, count + 1
            done = " ".join(f"{step}={at}" for step, at in one.subtasks.items())
            print(
                f"  {name} {engine} {start.index:2} {'won ' if one.success else 'lost'} {one.steps:4} steps "
                f"{time.perf_counter() - began:5.1f} s (policy {one.timings.policy:.1f})  {done}  {one.reason}"
                f"  {'; '.join(expert.log)}",
                flush=True,
            )
            if videos is not None:
                write_video(videos / f"{name}_{engine}_{start.index:02}.mp4", one.frames[camera], task.control_hz / 2)
    return good, count


def write_video(path: Path, frames: tuple[Image, ...], hz: float) -> None:
    """Write pictures as an MP4 with OpenCV, which the capture needs anyway."""
    import cv2

    path.parent.mkdir(parents=True, exist_ok=True)
    height, width = frames[0].shape[:2]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), hz, (width, height))
    for frame in frames:
        writer.write(cv2.cvtColor(frame, cv2.COLOR_RGB2BGR))
    writer.release()


def main() -> int:
    """Print task by task what was won; 1 where a bar is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tasks", nargs="*", default=["all"], help="names of tasks, or `all`")
    parser.add_argument("-n", type=int, default=ROLLOUTS)
    parser.add_argument("--world", nargs="+", default=["mujoco"], choices=world_names(), help="engines to compare")
    parser.add_argument("--videos", type=Path, help="a folder for a video of each rollout")
    parser.add_argument("--shard", default="1/1", help="only the rollouts i, i+k, ... of i/k")
    parser.add_argument("--cache", type=Path, help="a folder that keeps settled starts between runs")
    args = parser.parse_args()
    names = sorted(p.name.partition(".")[0] for p in SPECS.glob("*.task.yaml")) if args.tasks == ["all"] else args.tasks
    i, k = (int(v) for v in args.shard.split("/"))
    cache = Cache(args.cache) if args.cache else None
    rows = {
        (name, world): attempt(name, world, args.n, (i, k), args.videos, cache)
        for name in names
        for world in args.world
    }
    missed = [_is_missed(name, world, rows) for name, world in rows]
    for (name, world), miss in zip(rows, missed, strict=True):
        good, count = rows[name, world]
        bar = BAR if world == "mujoco" else None
        print(f"{name:28} {world:9} {good:2} of {count:2}{f'  (bar {bar} of 25)' if bar else ''}{'  MISSED' * miss}")
    return int(any(missed))


def _is_missed(name: str, world: str, rows: dict[tuple[str, str], tuple[int, int]]) -> bool:
    """Whether a task falls short: of its bar in MuJoCo, or of what MuJoCo wins in another engine."""
    good, count = rows[name, world]
    if world == "mujoco":
        return good * ROLLOUTS < BAR * count
    reference = rows.get((name, "mujoco"))
    return reference is not None and (reference[0] - good) * ROLLOUTS > APART * count


if __name__ == "__main__":
    raise SystemExit(main())
