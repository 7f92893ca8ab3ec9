"""How long a compile takes, for which targets, beside others and beside a floor: prints medians of one run.

    python -m tests.benchmarks.compile [--runs 11] [--json FILE]

The scene is that of :mod:`tests.benchmarks.reference`. ``in memory`` is timed from the text of a document to the bytes
of every file of all four backends: reading, checking, lowering, compiling; ``and written`` also writes them, with
manifests, each folder in one step. Both are warm: the same once more, untimed, comes just before. All are timed in
turns, so that what disturbs one disturbs the others. The floor only composes the YAML with PyYAML's C parser and writes
the same bytes plainly. ``processor`` is the processor time of ``in memory``, for machines that others keep busy. How to
set up the peers is said in :mod:`tests.benchmarks.peers`.
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from pathlib import Path

import yaml

from simfoundry.backends import BACKENDS, compile_scene
from simfoundry.backends.artifact import Artifact
from simfoundry.scene.lower import lower
from simfoundry.spec.load import load
from tests.benchmarks.peers import DOES, Peer, present
from tests.benchmarks.reference import document

COUNTS = (10, 100, 300, 1000)
TURNS_WITH_PEERS = 100
"""The number of things that peers are timed on."""

MEMORY = """
import resource, sys
from pathlib import Path
from tests.benchmarks.compile import compiled, document
import mujoco, pxr.Sdf
compiled(document(1), Path("one.scene.yaml"))
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
compiled(document(int(sys.argv[1])), Path("many.scene.yaml"))
print((resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024)
"""


def compiled(text: str, path: Path) -> list[Artifact]:
    """The artifacts of all backends from the text of a document."""
    scene = lower(load(path, text=text))
    return [compile_scene(scene, backend) for backend in BACKENDS.names()]


def write(artifacts: Iterable[Artifact], out: Path) -> None:
    """Write each artifact below ``out``."""
    for artifact in artifacts:
        artifact.write(out / artifact.target)


def floor(text: str, artifacts: Iterable[Artifact], out: Path) -> None:
    """The least that a compiler of YAML can do: compose it, and write what was compiled before."""
    yaml.CSafeLoader(text).get_single_node()
    for artifact in artifacts:
        folder = out / artifact.target
        for name, data in artifact.files.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(data)


def in_turns(works: dict[str, Callable[[], float]], runs: int) -> dict[str, float]:
    """Median seconds of each work, a turn of each after the other."""
    times: dict[str, list[float]] = {name: [] for name in works}
    for _ in range(runs):
        for name, work in works.items():
            times[name].append(work())
    return {name: statistics.median(found) for name, found in times.items()}


def timed(work: Callable[[], object], clock: Callable[[], float] = time.perf_counter) -> Callable[[], float]:
    """The same work, which returns its seconds."""

    def seconds() -> float:
        start = clock()
        work()
        return clock() - start

    return seconds


def warm(work: Callable[[], object], clock: Callable[[], float] = time.perf_counter) -> Callable[[], float]:
    """The same, timed the second time: what other work did to the processor's caches is not ours."""
    once = timed(work, clock)

    def seconds() -> float:
        work()
        return once()

    return seconds


def shell(path: Path, out: Path) -> None:
    """The whole command."""
    command = [sys.executable, "-m", "simfoundry.cli.main", "compile", str(path), "-o", str(out), "--force"]
    subprocess.run(command, check=True, capture_output=True)


def measured(count: int, runs: int, folder: Path) -> dict[str, float]:
    """Medians [s] of all that is timed on a scene of ``count`` things."""
    folder.mkdir()
    path, text = folder / "grid.scene.yaml", document(count)
    path.write_text(text)
    artifacts = compiled(text, path)
    works: dict[str, Callable[[], float]] = {
        "in memory": warm(lambda: compiled(text, path)),
        "processor": warm(lambda: compiled(text, path), time.process_time),
        "and written": warm(lambda: write(compiled(text, path), folder / "ours")),
        "floor": timed(lambda: floor(text, artifacts, folder / "floor")),
        "bare Python": timed(lambda: subprocess.run([sys.executable, "-c", "pass"], check=True)),
        "from the shell": timed(lambda: shell(path, folder / "shell")),
    }
    with ExitStack() as stack:
        for name in present() if count == TURNS_WITH_PEERS else ():
            works[name] = stack.enter_context(Peer(name, count, folder / name)).seconds
        return in_turns(works, runs if count < 1000 else max(3, runs // 3))


def memory(count: int) -> float:
    """Peak memory of a compile beyond that of a tiny one [MiB]."""
    done = subprocess.run([sys.executable, "-c", MEMORY, str(count)], check=True, capture_output=True, text=True)
    return float(done.stdout.split()[-1])


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=11)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    found: dict[str, dict[str, float]] = {}
    with tempfile.TemporaryDirectory() as base:
        for count in COUNTS:
            found[str(count)] = measured(count, arguments.runs, Path(base) / str(count))
    columns = ("in memory", "processor", "and written", "from the shell", "bare Python", "floor")
    print("milliseconds, medians\nthings  " + "  ".join(f"{name:>14}" for name in columns))
    for name, row in found.items():
        print(f"{name:>6}  " + "  ".join(f"{1000 * row[column]:14.1f}" for column in columns))
    ours = found[str(TURNS_WITH_PEERS)]["and written"]
    for peer in DOES.keys() & found[str(TURNS_WITH_PEERS)].keys():
        theirs = found[str(TURNS_WITH_PEERS)][peer]
        print(f"{TURNS_WITH_PEERS} things, {peer} ({DOES[peer]}): {1000 * theirs:.1f} ms, {theirs / ours:.1f} x ours")
    peak = memory(1000)
    print(f"peak memory of 1000 things beyond imports: {peak:.0f} MiB")
    if arguments.json is not None:
        arguments.json.write_text(json.dumps({"seconds": found, "memory_mib": peak}, indent=2) + "\n")


if __name__ == "__main__":
    main()
