"""Record the expert while the recording is killed: ``python -m tests.corpora.record [COUNT] [KILLS]``.

An arm that the package contains stacks a cube. The recording is killed with SIGKILL at random times, resumed, and its
bytes are compared with those of an undisturbed recording. Every demonstration is then replayed in a process of its own.
The printed figures include the simulated time per second of processor time.
"""

from __future__ import annotations

import os
import random
import resource
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import simfoundry as sf
from simfoundry.evaluate.policies.open_loop import ReplayPolicy
from simfoundry.evaluate.rollouts.rollout import rollout

SCENE = """\
simfoundry: scene/1
name: cell
objects:
  desk: {fixed: true, shape: {box: [1.4, 1.4, 0.04]}, pose: {xyz: [0.4, 0, -0.02]}}
  cube: {shape: {box: [0.04, 0.04, 0.04]}, density: 500, place: {on: desk, xy: [0.45, 0.1]}}
  crate: {shape: {box: [0.16, 0.16, 0.05]}, density: 500, place: {on: desk, xy: [0.45, -0.2]}}
robots:
  arm: {model: demo_arm, pose: {xyz: [0, 0, 0]}, joints: home}
"""
TASK = """\
simfoundry: task/1
name: stack
scene: cell.scene.yaml
instruction: Put the cube on the crate.
goal: {all: ["OnTop(cube, crate)", "Released(cube)"]}
reset: {objects: {cube: {x: [0.4, 0.5], y: [0.05, 0.15], yaw_deg: [-40, 40]}}}
horizon: 300
"""
REPLAY = "from tests.corpora.record import replay_all; import sys; replay_all(sys.argv[1])"


def main(count: int = 30, kills: int = 5) -> int:
    """Run the proof and print its figures."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        (folder / "cell.scene.yaml").write_text(SCENE)
        (folder / "stack.task.yaml").write_text(TASK)
        begun = time.monotonic()
        _record(folder / "plain", count).wait()
        used = resource.getrusage(resource.RUSAGE_CHILDREN)
        seconds = sum(demo.steps for demo in sf.demonstrations(folder / "plain")) / 15
        spent = used.ru_utime + used.ru_stime
        wall = time.monotonic() - begun
        print(f"{count} demonstrations of {seconds:.0f} s: {wall:.0f} s, {spent:.0f} s of processor time,", end=" ")
        print(f"{seconds / spent:.1f} simulated seconds per second of processor time")
        draws = random.Random(0)
        for _ in range(kills):
            process, before = _record(folder / "killed", count, jobs=2), _finished(folder / "killed")
            while process.poll() is None and _finished(folder / "killed") == before:
                time.sleep(0.02)
            time.sleep(draws.uniform(0, 3))
            os.kill(process.pid, signal.SIGKILL)
            process.wait()
            left = [len(list((folder / "killed" / name).glob("*.npz"))) for name in ("unfinished", "shards")]
            print(f"killed with {left[0]} finished attempts outside {left[1]} shards")
        _record(folder / "killed", count).wait()
        names = [path.relative_to(folder / "plain") for path in (folder / "plain").rglob("*") if path.is_file()]
        same = all((folder / "plain" / n).read_bytes() == (folder / "killed" / n).read_bytes() for n in names)
        print(f"{len(names)} files, {'the same bytes' if same else 'DIFFERENT BYTES'}")
        done = subprocess.run([sys.executable, "-c", REPLAY, str(folder / "killed")], check=False)
    return int(not same or done.returncode != 0)


def _finished(folder: Path) -> int:
    return len(list(folder.glob("*/*.npz")))


def _record(out: Path, count: int, jobs: int = 1) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "simfoundry", "record", str(out.parent / "stack.task.yaml"), "-o", str(out)]
    return subprocess.Popen([*command, "-n", str(count), "-j", str(jobs)], stderr=subprocess.DEVNULL)


def replay_all(folder: str) -> None:
    """Replay every demonstration in this process, and compare the digests of the trajectories."""
    demos = sf.demonstrations(folder)
    with demos.open() as world:
        wrong = 0
        for demo in demos:
            policy = ReplayPolicy(demo.actions, demo.action_space, "replay", demo.action_hz)
            wrong += rollout(demos.task, demo.start, policy, world).digest != demo.trajectory
    print(f"{len(demos)} demonstrations replayed in another process, {wrong} with a different trajectory")
    sys.exit(wrong > 0)


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:])))
