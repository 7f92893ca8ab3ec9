"""Build a dataset while the build is killed and its disk is full.

Run it as ``python -m tests.corpora.dataset [COUNT] [KILLS] [FORMAT]``. An arm that the package contains stacks a cube.
COUNT demonstrations are recorded, replayed to the bit in another process, and built into a dataset of two cameras at
320 x 180, with two processes. The build is repeated while it is killed with SIGKILL at random times, with files that
cannot grow, and in a folder that cannot be written; the bytes are compared, and the dataset is checked. The printed
figures include the time of the build and the processor time for each image.
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
from collections.abc import Callable
from pathlib import Path

import simfoundry as sf
from tests.corpora.record import REPLAY, SCENE, TASK

CAMERAS = """\
cameras:
  front: {size: [640, 360], fx: 420, fy: 420, pose: {xyz: [1.3, 0.2, 0.6], look_at: [0.4, 0, 0.1]}}
  side: {size: [640, 360], fx: 420, fy: 420, pose: {xyz: [0.4, 1.1, 0.5], look_at: [0.4, 0, 0.1]}}
"""
# Size of files at which a build fails [bytes]: less than an episode, more than any file before it.
FULL = 40_000


def main(count: int = 200, kills: int = 5, name: str = "lerobot-v3") -> int:
    """Run the proof and print its figures."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        (folder / "cell.scene.yaml").write_text(SCENE + CAMERAS)
        (folder / "stack.task.yaml").write_text(TASK)
        demos = folder / "demos"
        _run("record", folder / "stack.task.yaml", "-o", demos, "-n", count, "-j", 2).wait()
        replayed = subprocess.run([sys.executable, "-c", REPLAY, str(demos)], check=False).returncode == 0
        build = ("dataset", "build", demos, "-f", name, "-j", 2, "-o")
        plain = folder / "plain"
        seconds, spent = _timed(lambda: _run(*build, plain).wait())
        images = 2 * sf.dataset(plain).info.frames
        print(f"{count} demonstrations, {images} images of 320 x 180 in {name}: {seconds / 60:.1f} min,", end=" ")
        print(f"{spent / 60:.1f} min of processor time, {1000 * spent / images:.1f} ms for each image")
        _killed(build, folder / "killed", kills)
        same = _bytes(plain) == _bytes(folder / "killed")
        print(f"killed {kills} times: {len(_bytes(plain))} files, {'the same bytes' if same else 'DIFFERENT BYTES'}")
        faults = [_full_disk(build, folder / "full"), _unwritable(build, folder)]
        checked = _run("dataset", "check", plain).wait() == 0
        print(f"dataset check: {'no problems' if checked else 'PROBLEMS'}")
    return int(not (replayed and same and checked and all(faults)))


def _run(*args: object, stderr: int | None = subprocess.DEVNULL, full: bool = False) -> subprocess.Popen[str]:
    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (FULL, FULL))

    command = [sys.executable, "-m", "simfoundry", *map(str, args)]
    return subprocess.Popen(command, stderr=stderr, text=True, preexec_fn=limit if full else None)


def _timed(action: Callable[[], object]) -> tuple[float, float]:
    """Return the time and the processor time of child processes that an action takes [s]."""

    def spent() -> float:
        used = resource.getrusage(resource.RUSAGE_CHILDREN)
        return used.ru_utime + used.ru_stime

    before, begun = spent(), time.monotonic()
    action()
    return time.monotonic() - begun, spent() - before


def _killed(build: tuple[object, ...], out: Path, kills: int) -> None:
    """Kill a build at random times, and resume it in the end."""
    draws, staged = random.Random(0), out.parent / f".{out.name}.building" / "episodes"
    for _ in range(kills):
        process, before = _run(*build, out), _finished(staged)
        while process.poll() is None and _finished(staged) == before:
            time.sleep(0.02)
        time.sleep(draws.uniform(0, 3))
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
        print(
            f"killed with {_finished(staged)} finished episodes; {out.name} {'exists' if out.exists() else 'is absent'}"
        )
    _run(*build, out).wait()


def _finished(staged: Path) -> int:
    return len(list(staged.glob("[0-9]*")))


def _bytes(folder: Path) -> dict[str, bytes]:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def _full_disk(build: tuple[object, ...], out: Path) -> bool:
    """Build with files that cannot grow, and return True if there is one sentence and no dataset."""
    process = _run(*build, out, stderr=subprocess.PIPE, full=True)
    error = process.communicate()[1]
    lines = [line for line in error.splitlines() if "episodes …" not in line]
    print(f"full disk: exit code {process.returncode}: {' / '.join(lines)}")
    return process.returncode == 2 and len(lines) == 1 and not out.exists()


def _unwritable(build: tuple[object, ...], folder: Path) -> bool:
    """Build below a file instead of a folder, and return True if there is one sentence."""
    (folder / "file").touch()
    process = _run(*build, folder / "file" / "out", stderr=subprocess.PIPE)
    lines = process.communicate()[1].splitlines()
    print(f"unwritable folder: exit code {process.returncode}: {' / '.join(lines)}")
    return process.returncode == 2 and len(lines) == 1


if __name__ == "__main__":
    given = dict(zip(("count", "kills", "name"), sys.argv[1:], strict=False))
    sys.exit(main(int(given.get("count", 200)), int(given.get("kills", 5)), given.get("name", "lerobot-v3")))
