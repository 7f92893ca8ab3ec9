"""Batch commands on a Ray cluster that loses nodes: ``python -m tests.corpora.clusters [COMMAND ...]``.

Each command runs once on this machine, and once with `--on ray` on a cluster of three nodes, which Ray's own
``cluster_utils`` starts. When a quarter and when half of its results are there, a node is removed without notice, so
that only the head node is left. The results must have the same bytes, apart from times on a clock. Requires Ray.

Prints a line for each command; exit code 1 if any bytes differ.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from simfoundry.runtime.extras import is_installed
from tests.cli.command import MAIN
from tests.conftest import REPOSITORY
from tests.corpora.kills import Tree
from tests.corpora.record import SCENE, TASK

NODES = 3

# Times on a clock in the records of rollouts.
CLOCKS = rb'"(total|physics|render|policy|judge)": [0-9.]+'


@dataclass(frozen=True)
class Case:
    """A command.

    Attributes:
        name: Its name on the command line of this module.
        arguments: Its arguments.
        finished: The pattern of the files that it finishes one by one.
        count: The final number of these files.
        before: The arguments of a command that makes its inputs.
    """

    name: str
    arguments: tuple[str, ...]
    finished: str
    count: int
    before: tuple[str, ...] = ()


CASES = (
    Case("record", ("record", "stacks", "-n", "16", "-o", "out"), "out/*/*.npz", 16),
    Case(
        "augment",
        ("augment", "demos", "-n", "16", "-o", "out"),
        "out/*/*.npz",
        16,
        before=("record", "stacks", "-n", "4", "-j", "2", "-o", "demos"),
    ),
    Case(
        "eval", ("eval", "stacks", "-p", "expert", "-n", "8", "--no-video", "-o", "out"), "out/rollouts/**/*.json", 16
    ),
    Case(
        "cousins",
        ("cousins", "cousins/other_cups.cousins.yaml", "-n", "16", "--no-gallery", "-o", "out"),
        "out/[0-9]*.scene.yaml",
        16,
    ),
    Case(
        "dataset",
        ("dataset", "build", "demos", "-f", "lerobot-v3", "-o", "out"),
        ".out.building/episodes/[0-9]*",
        16,
        before=("record", "stacks", "-n", "16", "-j", "2", "-o", "demos"),
    ),
)

CAMERA = """
cameras:
  front: {size: [160, 120], fx: 150, fy: 150, pose: {xyz: [1.3, 0, 0.7], look_at: [0.4, 0, 0]}}
"""


def project(root: Path) -> Path:
    """Two tasks for an arm that the package contains, and the shipped documents."""
    shutil.copytree(REPOSITORY / "specs", root, ignore=shutil.ignore_patterns("*.py", "results", "pictures"))
    tasks = root / "stacks"
    for name, scene in (("a", SCENE), ("b", SCENE.replace("xy: [0.45, -0.2]", "xy: [0.4, -0.25]"))):
        (tasks / name).mkdir(parents=True)
        (tasks / name / "cell.scene.yaml").write_text(scene + CAMERA)
        (tasks / name / "stack.task.yaml").write_text(TASK.replace("name: stack", f"name: stack_{name}"))
    (root / "simfoundry.yaml").write_text("")
    return root


def start(arguments: Sequence[str], root: Path) -> subprocess.Popen[str]:
    """Start a command in a project, with an empty cache of its own."""
    cache = root.with_name(f"{root.name} cache")
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, sys.path)), "SIMFOUNDRY_CACHE": str(cache)}
    command = [sys.executable, "-c", MAIN, *arguments]
    return subprocess.Popen(
        command, cwd=root, env=environment, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True
    )


def tree(root: Path) -> Tree:
    """The bytes of each file of the output, without times on a clock."""
    files = sorted(path for path in (root / "out").rglob("*") if path.is_file())
    return {path.relative_to(root).as_posix(): re.sub(CLOCKS, b"", path.read_bytes()) for path in files}


def finished(case: Case, root: Path) -> int:
    """The number of files that are finished; a shard of a recording stands for its attempts."""
    return len(list(root.glob(case.finished)))


def losing_nodes(case: Case, root: Path, cluster: Any, workers: list[Any]) -> tuple[int, str, list[int]]:
    """Run a command on the cluster, and remove its workers on the way.

    Returns:
        The exit code, standard error, and the number of finished files when each node was removed.
    """
    process = start([*case.arguments, "--on", f"ray:{cluster.address}"], root)
    removed: list[int] = []
    for share, node in zip((0.25, 0.5), workers, strict=True):
        while process.poll() is None and finished(case, root) < share * case.count:
            time.sleep(0.05)
        if process.poll() is None:
            removed.append(finished(case, root))
            cluster.remove_node(node, allow_graceful=False)
    _, said = process.communicate(timeout=600)
    return process.returncode, said, removed


def prove(case: Case, folder: Path, new_cluster: Callable[[], Any]) -> bool:
    """Run a command on this machine and on a cluster; True if the bytes are the same."""
    here, there = project(folder / case.name / "here"), project(folder / case.name / "there")
    run_here = [*case.arguments, "-j", "2"]
    for arguments, root in [(case.before, here), (case.before, there), (run_here, here)]:
        begun = time.perf_counter()
        process = start(arguments or ["--version"], root)
        _, said = process.communicate(timeout=600)
        if process.returncode:
            print(f"{case.name}: exit code {process.returncode} on this machine: {said}")
            return False
    seconds = time.perf_counter() - begun
    cluster = new_cluster()
    try:
        workers = [cluster.add_node(num_cpus=1) for _ in range(NODES - 1)]
        cluster.wait_for_nodes()
        begun = time.perf_counter()
        code, said, removed = losing_nodes(case, there, cluster, workers)
        taken = time.perf_counter() - begun
    finally:
        cluster.shutdown()
    mine, theirs = tree(here), tree(there)
    different = [name for name in {*mine, *theirs} if mine.get(name) != theirs.get(name)]
    good = code == 0 and not different and len(removed) == NODES - 1
    after = " and ".join(map(str, removed))
    lost = f"two were removed after {after} of {case.count} results"
    outcome = "the same bytes" if good else f"exit code {code}, different: {sorted(different)[:5]} {said}"
    print(f"{case.name:<8} {seconds:.0f} s here; {taken:.0f} s on {NODES} nodes, of which {lost}: ", end="")
    print(f"{len(mine)} files, {outcome}", flush=True)
    return good


def main() -> int:
    """Prove the commands that are asked for; 1 if any bytes differ."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("commands", nargs="*", metavar="COMMAND", help=", ".join(case.name for case in CASES))
    given = parser.parse_args()
    if not is_installed("ray"):
        print("Ray is not installed; install it with `pip install 'simfoundry[ray]'`")
        return 0
    from ray.cluster_utils import Cluster

    def new_cluster() -> Any:
        return Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})

    good = True
    for case in CASES:
        if not given.commands or case.name in given.commands:
            with tempfile.TemporaryDirectory(prefix="simfoundry-clusters-") as folder:
                good &= prove(case, Path(folder), new_cluster)
    return int(not good)


if __name__ == "__main__":
    sys.exit(main())
