"""The speed of recording: ``python -m tests.benchmarks.record [COUNT] [TASK]``.

Records the expert with one process, and prints how many seconds of kept demonstrations are simulated per second of
processor time. The time includes the start of the program, the initial states (with an empty cache), failed attempts
and the verification by replay. Then it does the same for as many tasks as demonstrations, so that every attempt opens
another scene, as in a folder of cousins. Without TASK, it takes Cup in Bowl of ``specs/`` if the model of its robot is
there, and otherwise a task for the arm in the package. Exit code 1 if either is slower than twice real time.
"""

from __future__ import annotations

import os
import resource
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import simfoundry as sf
from simfoundry.evaluate.task import load_task
from tests.corpora.record import SCENE, TASK

# tests.conftest would hide the robots' models.
REPOSITORY = Path(__file__).resolve().parents[2]

COUNT, REQUIRED = 20, 2.0


def processor_time() -> float:
    """The processor time of all child processes that have ended [s]."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def measure(name: str, tasks: Sequence[Path], out: Path, count: int) -> float:
    """Record tasks, print the figures, and return the simulated seconds per second of processor time."""
    command = [
        sys.executable,
        "-m",
        "simfoundry",
        "record",
        *map(str, tasks),
        "-n",
        str(count),
        "-o",
        str(out),
        "--json",
    ]
    environment = {**os.environ, "SIMFOUNDRY_CACHE": str(out.with_name("cache"))}
    before = processor_time()
    subprocess.run(command, check=True, env=environment, stdout=subprocess.DEVNULL)
    spent = processor_time() - before
    demos = sf.demonstrations(out)
    simulated = float(sum(demo.steps / demo.about["control_hz"] for demo in demos))
    print(f"{name}: {len(demos)} demonstrations of {simulated:.0f} s in {spent:.1f} s of processor time, "
          f"{simulated / spent:.1f} simulated seconds per second", flush=True)  # fmt: skip
    return simulated / spent


def documents(folder: Path, task: Path | None) -> Path:
    """A task document."""
    shipped = REPOSITORY / "specs" / "tasks" / "cup_in_bowl.task.yaml"
    if task is not None or not load_task(shipped).missing_robots:
        return task or shipped
    (folder / "cell.scene.yaml").write_text(SCENE)
    (folder / "stack.task.yaml").write_text(TASK)
    return folder / "stack.task.yaml"


def copies(task: Path, folder: Path, count: int) -> list[Path]:
    """Tasks with the same content in documents of their own."""
    shutil.copytree(REPOSITORY / "specs", folder / "specs")
    (folder / "simfoundry.yaml").write_text("")
    place = folder / "specs" / "tasks" if REPOSITORY in task.resolve().parents else folder
    if place == folder:
        for file in task.parent.glob("*.yaml"):
            shutil.copy(file, folder)
    names = [place / f"copy_{k:04d}.task.yaml" for k in range(count)]
    for name in names:
        shutil.copy(task, name)
    return names


def main(count: int = COUNT, task: str = "") -> int:
    """Print the figures; 1 if one of them is too low."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        (folder / "copies").mkdir()
        document = documents(folder, Path(task) if task else None)
        one = measure(f"{document.name}", [document], folder / "one", count)
        many = measure(f"{count} tasks", copies(document, folder / "copies", count), folder / "many", count)
    return int(min(one, many) < REQUIRED)


if __name__ == "__main__":
    sys.exit(main(*(kind(value) for kind, value in zip((int, str), sys.argv[1:], strict=False))))
