"""The hooks as others use them, in a repository of their own: ``python -m tests.corpora.hooks``.

pre-commit clones the last commit of this repository and installs it, so this takes as long as `pip install` does.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import yaml

REPOSITORY = Path(__file__).resolve().parents[2]

SCENE = """\
simfoundry: scene/1
name: desk

objects:
  cup:
    shape: {sphere: 0.04}
    mass: 0.2
"""
STEPS = (
    ("a good document", "simfoundry-check", SCENE, 0, "Passed"),
    ("a wrong key", "simfoundry-check", SCENE.replace("mass", "mas"), 1, "error[SF101] unknown key `mas`"),
    ("canonical form", "simfoundry-fmt", SCENE, 0, "Passed"),
    (
        "another form",
        "simfoundry-fmt",
        SCENE.replace("name: desk", "name:   desk"),
        1,
        "files were modified by this hook",
    ),
    ("after that hook", "simfoundry-fmt", None, 0, "Passed"),
)
"""What is tried, with which hook, on which document (None: as it was left), and what must come of it."""


def git(folder: Path, *args: str) -> str:
    """What a git command prints."""
    author = ("-c", "user.name=proof", "-c", "user.email=proof@example.org", "-c", "commit.gpgsign=false")
    done = subprocess.run(["git", *author, *args], cwd=folder, capture_output=True, text=True, check=True)
    return done.stdout.strip()


def hook(folder: Path, name: str) -> subprocess.CompletedProcess[str]:
    """Run one hook on all files of a repository; its environment is built below the folder on first use."""
    return subprocess.run(
        [sys.executable, "-m", "pre_commit", "run", "--all-files", "--verbose", name],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PRE_COMMIT_HOME": str(folder.parent / "pre-commit"), "PYTHONPATH": ""},
    )


def prepared(folder: Path) -> Path:
    """A repository that uses the hooks of this one, as of its last commit."""
    source, user = folder / "simfoundry", folder / "user"
    git(folder, "clone", "--quiet", str(REPOSITORY), str(source))
    user.mkdir()
    git(user, "init", "--quiet")
    names = [h["id"] for h in yaml.safe_load((source / ".pre-commit-hooks.yaml").read_text())]
    revision = git(source, "rev-parse", "HEAD")
    config = {"repos": [{"repo": str(source), "rev": revision, "hooks": [{"id": name} for name in names]}]}
    (user / ".pre-commit-config.yaml").write_text(yaml.safe_dump(config))
    (user / "notes.yaml").write_text("not: [ours\n")  # no document: it must be passed over
    return user


def explained(folder: Path) -> bool:
    """Whether the package that pre-commit built and installed brings the pages of all codes."""
    program = next((folder / "pre-commit").glob("repo*/py_env-*/bin/simfoundry"))
    env = {**os.environ, "PYTHONPATH": ""}
    done = subprocess.run(
        [program, "check", "--format", "sarif", "user"],
        cwd=folder,
        env=env,
        capture_output=True,
        text=True,
        check=False,
    )
    rules = json.loads(done.stdout)["runs"][0]["tool"]["driver"]["rules"]
    return all("**How to fix it.**" in rule["help"]["markdown"] for rule in rules)


def main() -> int:
    """Print a line for each step; the exit code is 1 where one went otherwise."""
    if not (REPOSITORY / ".git").exists():
        print("pre-commit clones a repository, and this copy is none", file=sys.stderr)
        return 1
    failed = 0
    with tempfile.TemporaryDirectory() as folder:
        user = prepared(Path(folder))
        for what, name, text, code, words in STEPS:
            if text is not None:
                (user / "desk.scene.yaml").write_text(text)
            git(user, "add", "--all")
            start = time.perf_counter()
            done = hook(user, name)
            right = done.returncode == code and words in done.stdout
            failed += not right
            print(
                f"{'ok' if right else 'FAILED':<7}{name:<18}{what:<18}{time.perf_counter() - start:6.1f} s", flush=True
            )
            if not right:
                print(done.stdout, done.stderr, sep="\n")
        pages = explained(Path(folder))
        failed += not pages
        print(f"{'ok' if pages else 'FAILED':<7}the installed package explains every code")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
