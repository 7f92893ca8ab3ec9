"""Documents that were made to do harm: each is refused with a finding, within 1 s and 300 MB.

``python -m tests.corpora.hostile`` runs `simfoundry check` on each in a process of its own, and prints time and memory.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

SECONDS, MEGABYTES = 1.0, 300
HEAD = "simfoundry: scene/1\nname: a\n"


def alias_bomb(path: Path) -> None:
    """Ten levels of ten aliases each: 10^10 values."""
    levels = ["a0: &a0 [x, x, x, x, x, x, x, x, x, x]"]
    levels += [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 10)}]" for k in range(1, 10)]
    path.write_text(HEAD + "\n".join(levels) + "\n")


def deep_lists(path: Path) -> None:
    """100,000 brackets."""
    path.write_text(HEAD + "objects: " + "[" * 100_000 + "]" * 100_000 + "\n")


def deep_mappings(path: Path) -> None:
    """100,000 braces, never closed."""
    path.write_text(HEAD + "objects: " + "{a: " * 100_000)


def deep_blocks(path: Path) -> None:
    """1,500 levels of indentation."""
    path.write_text(HEAD + "objects:\n" + "".join(" " * (k + 1) + "a:\n" for k in range(1500)))


def long_scalar(path: Path) -> None:
    """One text of 200 MB."""
    with path.open("w") as stream:
        stream.write(HEAD + 'description: "')
        for _ in range(200):
            stream.write("x" * 1_000_000)
        stream.write('"\n')


def long_line(path: Path) -> None:
    """A line of almost as much as is read, with a slip at its end."""
    path.write_text(HEAD + "description: " + "x" * 4_000_000 + ": : [\n")


def many_keys(path: Path) -> None:
    """As many unknown keys as fit."""
    path.write_text(HEAD + "".join(f"k{k}: 1\n" for k in range(149_000)))


def many_objects(path: Path) -> None:
    """Tens of thousands of faulty objects."""
    path.write_text(HEAD + "objects:\n" + "".join(f"  o{k}: {{mas: 1}}\n" for k in range(40_000)))


def tag(path: Path) -> None:
    """A tag that asks for code."""
    path.write_text(HEAD + "description: !!python/object/apply:os.system ['touch owned']\n")


def latin_1(path: Path) -> None:
    """Bytes that are no UTF-8."""
    path.write_bytes(HEAD.encode() + b"description: caf\xe9\n")


def utf_16(path: Path) -> None:
    """UTF-16 with its mark."""
    path.write_bytes((HEAD + "description: a\n").encode("utf-16"))


def nul(path: Path) -> None:
    """A NUL in a name."""
    path.write_bytes(b"simfoundry: scene/1\nname: a\0b\n")


def recursive_anchor(path: Path) -> None:
    """A list that contains itself."""
    path.write_text(HEAD + "objects: &a {b: *a}\n")


def recursive_key(path: Path) -> None:
    """A mapping that is its own key."""
    path.write_text(HEAD + "objects: &a {*a : 1}\n")


def link_out(path: Path) -> None:
    """An asset that is a link to a file outside of the project."""
    secret = path.parent.parent / "secret.obj"
    secret.write_text("v 0 0 0\n")
    (path.parent / "inside.obj").symlink_to(secret)
    path.write_text(HEAD + "objects: {a: {asset: inside.obj, mass: 1}}\n")


def path_out(path: Path) -> None:
    """An asset and a base outside of the project."""
    path.write_text(HEAD + "extends: ../../../../etc/passwd\nobjects: {a: {asset: /etc/passwd, mass: 1}}\n")


def ring_of_links(path: Path) -> None:
    """An asset whose joints form a cycle."""
    (path.parent / "a.obj").symlink_to("b.obj")
    (path.parent / "b.obj").symlink_to("a.obj")
    path.write_text(HEAD + "objects: {a: {asset: a.obj, mass: 1}}\n")


def a_pipe(path: Path) -> None:
    """A pipe that nobody writes to."""
    os.mkfifo(path)


def a_device(path: Path) -> None:
    """A link to a device that never ends."""
    path.symlink_to("/dev/zero")


def itself(path: Path) -> None:
    """A scene that is its own asset and its own base."""
    path.write_text(f"simfoundry: scene/1\nextends: {path.name}\nname: a\nobjects: {{a: {{asset: {path.name}}}}}\n")


def long_name(path: Path) -> None:
    """A name of a megabyte, and a path of one."""
    path.write_text(f"{HEAD}objects: {{{'a' * 1000}: {{asset: {'b' * 1_000_000}.obj, mass: 1}}}}\n")


def deep_condition(path: Path) -> None:
    """Relations with a thousand parentheses."""
    path.write_text(HEAD + "relations: ['" + "OnTop(" * 1000 + "a" + ")" * 1000 + "']\n")


def steering(path: Path) -> None:
    """Keys that steer a terminal."""
    path.write_text(HEAD + '"\\e]0;owned\\a": 1\n"\\e[2J": 2\n')


CASES: tuple[Callable[[Path], None], ...] = (
    alias_bomb,
    deep_lists,
    deep_mappings,
    deep_blocks,
    long_scalar,
    long_line,
    many_keys,
    many_objects,
    tag,
    latin_1,
    utf_16,
    nul,
    recursive_anchor,
    recursive_key,
    link_out,
    path_out,
    ring_of_links,
    a_pipe,
    a_device,
    itself,
    long_name,
    deep_condition,
    steering,
)


@dataclass(frozen=True)
class Refusal:
    """What `simfoundry check` made of a document."""

    code: int
    text: str
    seconds: float
    megabytes: float

    @property
    def refused(self) -> bool:
        """Whether it said what is wrong, in findings and nothing else."""
        clean = "Traceback" not in self.text and not any(c in self.text for c in "\x1b\x07\0")
        return self.code == 1 and "error[SF" in self.text and clean


def refuse(make: Callable[[Path], None], limit: float = 60.0) -> Refusal:
    """Check the document that ``make`` writes, in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        project = Path(folder) / "project"
        (project / ".git").mkdir(parents=True)
        path = project / "a.scene.yaml"
        make(path)
        output = Path(folder) / "output"
        command = [sys.executable, "-m", "simfoundry.cli.main", "check", path.name]
        with output.open("wb") as stream:
            started, peak = time.perf_counter(), 0.0
            process = subprocess.Popen(
                command, cwd=project, stdout=stream, stderr=subprocess.STDOUT, env=_environment()
            )
            while process.poll() is None:
                peak = max(peak, _peak(process.pid))
                if time.perf_counter() - started > limit:
                    process.kill()
                time.sleep(0.002)
            seconds = time.perf_counter() - started
        assert not (project / "owned").exists()
        text = output.read_text(errors="replace")
        return Refusal(process.returncode, text, seconds, peak)


def _peak(pid: int) -> float:
    """The most memory [MB] that a running process has had; what the kernel tells at its end counts its parent's too."""
    try:
        status = Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return 0.0
    return next((int(line.split()[1]) / 1024 for line in status.splitlines() if line.startswith("VmHWM:")), 0.0)


def _environment() -> dict[str, str]:
    from tests.conftest import REPOSITORY

    return {**os.environ, "PYTHONPATH": str(REPOSITORY)}


def main() -> int:
    """Print the table; 1 where a bar is missed."""
    missed = 0
    print("| document | refused | s | MB |\n|---|---|---|---|")
    for make in CASES:
        done = refuse(make)
        kept = done.refused and done.seconds <= SECONDS and done.megabytes <= MEGABYTES
        missed += not kept
        said = "yes" if done.refused else f"NO ({done.code})"
        print(f"| {make.__name__} | {said} | {done.seconds:.2f} | {done.megabytes:.0f} |{'' if kept else ' <- missed'}")
    return int(missed > 0)


if __name__ == "__main__":
    sys.exit(main())
