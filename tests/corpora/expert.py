"""The scripted expert on the tasks of ``specs/``: how many of 25 rollouts of the paper's protocol it wins.

    python -m tests.corpora.expert [--tasks NAME ...] [-n 25] [--videos FOLDER] [--shard 1/2]

Needs the robots' models (docs/robots.md). Exits with 1 where a task of :data:`BARS` falls short of its bar.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from simfoundry.assets.cache import Cache
from simfoundry.evaluate.expert.policy import Expert
from simfoundry.evaluate.judging import judge_of
from simfoundry.evaluate.policies.base import Image, ImageSize
from simfoundry.evaluate.rollout import Rollout, Video, rollout
from simfoundry.evaluate.starts import starts
from simfoundry.evaluate.task import load_task
from simfoundry.worlds import open_world

SPECS = Path(__file__).parents[2] / "specs" / "tasks"
ROLLOUTS = 25

BARS = {"cup_in_bowl": 20, "marker_in_cup": 20, "serve_fruits": 20, "store_marker": 20}
"""How many of 25 rollouts must be won."""

DRAWER = ("open_drawer", "close_drawer")
"""Of Store Marker these steps count."""


def won(name: str, one: Rollout) -> bool:
    """Whether a rollout counts for the bar."""
    if name == "store_marker":
        return all(one.subtasks[step] is not None for step in DRAWER)
    return one.success


def attempt(name: str, n: int, shard: tuple[int, int], videos: Path | None, cache: Cache | None) -> tuple[int, int]:
    """Roll out one task; prints each rollout, returns how many were won and how many there were."""
    task = load_task(SPECS / f"{name}.task.yaml", cache)
    all_starts = starts(task, n, cache=cache)
    expert, judge = Expert(task), judge_of(task.scene)
    good = count = 0
    camera = next(iter(camera.name for camera in task.scene.cameras))
    video = Video({camera: ImageSize(480, 270)}, every=2) if videos is not None else None
    with open_world(task.scene, "mujoco") as world:
        for start in all_starts[shard[0] - 1 :: shard[1]]:
            began = time.perf_counter()
            one = rollout(task, start, expert, world, judge, video)
            good, count = good + won(name, one), count + 1
            done = " ".join(f"{step}={at}" for step, at in one.subtasks.items())
            print(
                f"  {name} {start.index:2} {'won ' if one.success else 'lost'} {one.steps:4} steps "
                f"{time.perf_counter() - began:5.1f} s (policy {one.timings.policy:.1f})  {done}  {one.reason}"
                f"  {'; '.join(expert.log)}",
                flush=True,
            )
            if videos is not None:
                write_video(videos / f"{name}_{start.index:02}.mp4", one.frames[camera], task.control_hz / 2)
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
    parser.add_argument("--tasks", nargs="*", default=sorted(BARS), help="names of tasks, or `all`")
    parser.add_argument("-n", type=int, default=ROLLOUTS)
    parser.add_argument("--videos", type=Path, help="a folder for a video of each rollout")
    parser.add_argument("--shard", default="1/1", help="only the rollouts i, i+k, ... of i/k")
    parser.add_argument("--cache", type=Path, help="a folder that keeps settled starts between runs")
    args = parser.parse_args()
    names = sorted(p.name.partition(".")[0] for p in SPECS.glob("*.task.yaml")) if args.tasks == ["all"] else args.tasks
    i, k = (int(v) for v in args.shard.split("/"))
    rows = {}
    for name in names:
        rows[name] = attempt(name, args.n, (i, k), args.videos, Cache(args.cache) if args.cache else None)
    short = False
    for name, (good, count) in rows.items():
        bar = BARS.get(name)
        missed = bar is not None and good * ROLLOUTS < bar * count
        short = short or missed
        print(f"{name:28} {good:2} of {count:2}{f'  (bar {bar} of 25)' if bar else ''}{'  MISSED' if missed else ''}")
    return int(short)


if __name__ == "__main__":
    raise SystemExit(main())
