"""Run the real command line as a user does, and measure what it costs."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
CLI = (sys.executable, "-m", "simfoundry.cli.main")

# The peak that the kernel reports for a child includes that of the process which started it, so this small process
# stands between, and not the large one that has simulators loaded. Its arguments: where to write, then the command.
_LAUNCHER = """
import json, os, sys, time
start = time.perf_counter()
pid = os.posix_spawnp(sys.argv[2], sys.argv[2:], os.environ)
_, status, used = os.wait4(pid, 0)
seconds = time.perf_counter() - start
measured = [os.waitstatus_to_exitcode(status), seconds, used.ru_utime + used.ru_stime, used.ru_maxrss]
json.dump(measured, open(sys.argv[1], "w"))
"""


@dataclass(frozen=True)
class Ran:
    """What a command did: exit code, wall and processor time [s], peak memory [MB], and what it printed."""

    code: int
    seconds: float
    cpu_seconds: float
    megabytes: float
    output: str
    errors: str

    def last_words(self) -> str:
        """What it said when it failed, on one line."""
        lines = [line.strip() for line in (self.errors or self.output).splitlines() if line.strip()]
        return f"exit code {self.code}: {' / '.join(lines[-3:])[:300]}"


def environment(cache: Path, hash_seed: int) -> dict[str, str]:
    """The environment of a user without a display, with a cache of its own and a given order of hashes."""
    bare = {key: value for key, value in os.environ.items() if key not in ("DISPLAY", "WAYLAND_DISPLAY")}
    own = {"SIMFOUNDRY_CACHE": str(cache), "PYTHONHASHSEED": str(hash_seed), "PYTHONPATH": str(ROOT)}
    return bare | own


def run(command: tuple[str, ...], cwd: Path, env: dict[str, str], timeout: float = 600.0) -> Ran:
    """Run a command to its end; one that takes longer than ``timeout`` [s] is stopped and has the code -9."""
    with tempfile.TemporaryDirectory(prefix="simfoundry-run-") as folder:
        measured = Path(folder) / "measured.json"
        launch = (sys.executable, "-S", "-c", _LAUNCHER, str(measured), *command)
        process = subprocess.Popen(
            launch, cwd=cwd, env=env, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
        )
        try:
            output, errors = process.communicate(timeout=timeout)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
            return Ran(-9, timeout, 0.0, 0.0, "", f"stopped after {timeout:.0f} s")
        code, seconds, cpu_seconds, kilobytes = json.loads(measured.read_text())
    return Ran(code, seconds, cpu_seconds, kilobytes / 1024, output, errors)


def different_files(a: Path, b: Path) -> list[str]:
    """Paths of files that two folders do not hold alike, byte by byte."""
    first, second = _contents(a), _contents(b)
    return sorted(path for path in first.keys() | second.keys() if first.get(path) != second.get(path))


def _contents(folder: Path) -> dict[str, bytes]:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}
