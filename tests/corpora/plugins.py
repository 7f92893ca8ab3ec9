"""A package from outside, really installed: ``python -m tests.corpora.plugins``.

Builds the package that the code blocks of ``docs/extend`` write, installs it with pip into a fresh environment, and
runs every command that sees an extension, from an empty folder. Prints one line a command; exits with 1 if any fails.
"""

from __future__ import annotations

import os
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path

from tests.foreign_package import documented_package
from tests.test_extend import SCENE, TASK

REPOSITORY = Path(__file__).resolve().parents[2]
COMMANDS = {
    "check bench.scene.yaml lift.task.yaml": "",
    "judge bench.scene.yaml Higher(block,0.01)": "Higher(block, 0.01)",
    "compile bench.scene.yaml -t my_sim -t bodies -o build": "my_sim",
    "verify bench.scene.yaml --engine my_sim --require my_sim --no-behaviors": "my_sim",
    "eval lift.task.yaml -p hold=my_protocol:localhost?action_space=joint_position -n 1 --no-video -o out": "hold",
}  # each command with a text that its output contains
MATRIX = "from simfoundry.targets.generated import support_page; print(support_page())"


def main() -> int:
    """Install the package and run the commands; returns the exit code."""
    with tempfile.TemporaryDirectory(prefix="simfoundry-plugins-") as temporary:
        home = Path(temporary)
        python = installed(home)
        bench = home / "bench"
        bench.mkdir()
        (bench / "bench.scene.yaml").write_text(SCENE, encoding="utf-8")
        (bench / "lift.task.yaml").write_text(TASK, encoding="utf-8")
        runs = {f"simfoundry {line}": (["-m", "simfoundry", *line.split()], text) for line, text in COMMANDS.items()}
        runs["support matrix"] = (["-c", MATRIX], "| `my_sim` | bodies | 1.0 |")
        failures = sum(not succeeds(name, [python, *words], text, bench) for name, (words, text) in runs.items())
        return int(failures > 0)


def installed(home: Path) -> str:
    """The interpreter of a new environment below ``home`` with the package, and what this environment has beneath."""
    entries, files = documented_package()
    lines = ["[build-system]", 'requires = ["hatchling"]', 'build-backend = "hatchling.build"']
    lines += ["[project]", 'name = "my-package"', 'version = "0.1"']
    for group, found in entries.items():
        lines += [f'[project.entry-points."{group}"]', *(f'{name} = "{value}"' for name, value in found.items())]
    lines += ["[tool.hatch.build.targets.wheel]", 'packages = ["my_package"]']
    for path, text in {**files, "pyproject.toml": "\n".join(lines)}.items():
        file = home / "source" / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, encoding="utf-8")
    subprocess.run([sys.executable, "-m", "venv", str(home / "venv")], check=True)
    python = home / "venv" / "bin" / "python"
    site = next((home / "venv" / "lib").glob("python*/site-packages"))
    (site / "beneath.pth").write_text(f"{sysconfig.get_path('purelib')}\n{REPOSITORY}\n")
    options = ["--no-build-isolation", "--no-deps", "--no-index", "--quiet", "--disable-pip-version-check"]
    subprocess.run([python, "-m", "pip", "install", *options, str(home / "source")], check=True, env=environment())
    return str(python)


def environment() -> dict[str, str]:
    """The environment without a path that would hide what is installed."""
    return {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}


def succeeds(name: str, command: list[str], text: str, folder: Path) -> bool:
    """Run a command in ``folder``; print whether it ends well and its output contains ``text``."""
    done = subprocess.run(command, cwd=folder, env=environment(), capture_output=True, text=True, check=False)
    good = done.returncode == 0 and text in done.stdout + done.stderr
    print(f"{'ok  ' if good else 'FAIL'} {name}", flush=True)
    if not good:
        print(done.stdout + done.stderr)
    return good


if __name__ == "__main__":
    sys.exit(main())
