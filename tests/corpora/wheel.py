"""The tests against the package as users install it: a wheel, with the checkout's own package out of reach.

    python -m tests.corpora.wheel [PYTEST OPTION ...]

Builds the wheel, installs it with the extra ``dev`` into an environment of its own, copies everything of the repository
but the package itself, and runs pytest there. Exits as pytest does. Needs a package index.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]

LEFT_OUT = ("simfoundry", ".git", ".venv", "build", "dist", "__pycache__", "node_modules")
"""What is not copied: the package, and what a checkout gathers."""


def main(options: list[str]) -> int:
    """Run the tests; returns the exit code of pytest."""
    with tempfile.TemporaryDirectory(prefix="simfoundry-wheel-") as folder:
        home = Path(folder)
        python = installed(home)
        copy = home / "parent" / "checkout"
        shutil.copytree(REPOSITORY, copy, ignore=shutil.ignore_patterns(*LEFT_OUT), symlinks=True)
        shared = REPOSITORY.parent / "shared"
        if shared.is_dir():
            (copy.parent / "shared").symlink_to(shared)
        subprocess.run(["git", "init", "--quiet", str(copy)], check=True)
        subprocess.run(["git", "-C", str(copy), "add", "--all"], check=True)
        env = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
        return subprocess.run([python, "-m", "pytest", *options], cwd=copy, env=env, check=False).returncode


def installed(home: Path) -> Path:
    """The interpreter of a new environment below ``home`` that has the wheel and what the tests need."""
    environment = home / "venv"
    subprocess.run([sys.executable, "-m", "venv", str(environment)], check=True)
    python = environment / "bin" / "python"
    pip = [str(python), "-m", "pip", "--quiet", "--disable-pip-version-check"]
    subprocess.run([*pip, "wheel", "--no-deps", "--wheel-dir", str(home), str(REPOSITORY)], check=True)
    wheel = next(home.glob("*.whl"))
    constraints = REPOSITORY / "constraints.txt"
    subprocess.run([*pip, "install", "--constraint", str(constraints), f"{wheel}[dev]"], check=True)
    return python


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
