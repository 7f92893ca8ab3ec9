"""What others build on: the hooks for pre-commit, and the GitHub action, whose steps are run here."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
import yaml

from simfoundry.cli.main import COMMANDS
from simfoundry.spec.models.kinds import KINDS, suffix
from tests.conftest import REPOSITORY

HOOKS: list[dict[str, Any]] = yaml.safe_load((REPOSITORY / ".pre-commit-hooks.yaml").read_text())
ACTION: dict[str, Any] = yaml.safe_load((REPOSITORY / "action.yml").read_text())

GOOD = "simfoundry: scene/1\nname: good\nobjects:\n  cup:\n    shape: {sphere: 0.04}\n    mass: 0.2\n"
BAD = GOOD.replace("mass", "mas")

SIMFOUNDRY = f"""\
#!/bin/sh
PYTHONPATH={REPOSITORY} exec {sys.executable} -m simfoundry.cli.main "$@"
"""
RECORDER = """\
#!/bin/sh
printf '%s\\n' "$@" > "$RECORD"
"""


# -- hooks ----------------------------------------------------------------------------------------------------------


def test_the_hooks_call_commands_that_exist() -> None:
    assert [hook["id"] for hook in HOOKS] == ["simfoundry-check", "simfoundry-fmt"]
    for hook in HOOKS:
        program, command = hook["entry"].split()
        assert program == "simfoundry" and command in COMMANDS
        assert hook["language"] == "python" and hook.get("pass_filenames", True)


def test_the_hooks_run_on_every_kind_of_document_and_on_nothing_else() -> None:
    documents = [f"a/desk{suffix(kind)}" for kind in KINDS] + ["capture.yaml", "captures/desk/capture.yaml"]
    others = ["notes.yaml", "scene.yaml", "desk.scene.yaml.orig", "desk.scene.yml", "mycapture.yaml", "desk_scene.yaml"]
    for hook in HOOKS:
        found = [name for name in documents + others if re.search(hook["files"], name)]
        assert found == documents


# -- the action -----------------------------------------------------------------------------------------------------


def steps() -> dict[str, dict[str, Any]]:
    """The steps of the action that run a script, by name."""
    return {step["name"]: step for step in ACTION["runs"]["steps"] if "run" in step}


@pytest.fixture
def job(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The checkout of a repository with two documents, a good and a bad one."""
    monkeypatch.delenv("GITHUB_WORKSPACE", raising=False)
    checkout = tmp_path / "checkout"
    (checkout / "my scenes").mkdir(parents=True)
    (checkout / "simfoundry.yaml").touch()
    (checkout / "my scenes" / "bad.scene.yaml").write_text(BAD)
    (checkout / "good.scene.yaml").write_text(GOOD)
    return checkout


def program(folder: Path, name: str, text: str) -> None:
    """A program that a script finds first."""
    folder.mkdir(exist_ok=True)
    (folder / name).write_text(text)
    (folder / name).chmod(0o755)


def run_step(
    name: str, job: Path, context: Mapping[str, str] | None = None, **inputs: str
) -> subprocess.CompletedProcess[str]:
    """Run a step as GitHub does: inputs in its environment, bash that stops at the first error.

    ``context`` holds the values of expressions such as ``github.token``, and variables of the environment in capitals.
    """
    step = steps()[name]
    given = {f"inputs.{key}": str(field.get("default", "")) for key, field in ACTION["inputs"].items()}
    given |= {f"inputs.{key}": value for key, value in inputs.items()} | dict(context or {})

    def filled(text: str) -> str:
        return re.sub(r"\$\{\{ ([a-z_.-]+) \}\}", lambda match: given[match[1]], text)

    env = {key: filled(value) for key, value in step["env"].items()}
    path = f"{job.parent / 'bin'}{os.pathsep}{os.environ['PATH']}"
    return subprocess.run(
        [step["shell"], "--noprofile", "--norc", "-eo", "pipefail", "-c", step["run"]],
        cwd=job,
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, **env, "PATH": path, "GITHUB_ACTION_PATH": "/the action", "RECORD": str(job / "record")}
        | {key: value for key, value in given.items() if key.isupper()},
    )


@pytest.fixture
def tool(job: Path) -> None:
    program(job.parent / "bin", "simfoundry", SIMFOUNDRY)


def test_no_input_is_pasted_into_a_script() -> None:
    """It could hold commands."""
    assert list(steps()) == ["Install", "Describe", "Comment", "Check"]
    for step in steps().values():
        assert "${{" not in step["run"]
        assert all(re.fullmatch(r"\$\{\{ [a-z_.-]+ \}\}(/[a-z-]+)?", value) for value in step["env"].values())
    used = set(re.findall(r"inputs\.(\w+)", str(ACTION["runs"])))
    assert used == set(ACTION["inputs"])


@pytest.mark.usefixtures("tool")
def test_the_action_annotates_and_fails_where_there_are_findings(job: Path) -> None:
    done = run_step("Check", job)
    assert done.returncode == 1 and done.stderr == ""
    lines = done.stdout.splitlines()
    assert "::error file=my scenes/bad.scene.yaml,line=6,col=5,endColumn=8,title=SF101::unknown key `mas`" in lines[0]
    assert lines[1:] == ["1 error in 1 of 2 documents"]


@pytest.mark.usefixtures("tool")
def test_the_action_checks_the_paths_that_it_is_given(job: Path) -> None:
    assert run_step("Check", job, paths="good.scene.yaml\n").returncode == 0
    both = run_step("Check", job, paths="good.scene.yaml\nmy scenes\n")
    assert both.returncode == 1 and both.stdout.endswith("1 error in 1 of 2 documents\n")
    missing = run_step("Check", job, paths="nowhere")
    assert missing.returncode == 2 and "nowhere does not exist" in missing.stderr
    sly = run_step("Check", job, paths='$(touch sly); "; touch sly #')
    assert sly.returncode == 2 and not (job / "sly").exists()
    assert run_step("Check", job, paths="--help").returncode == 2


@pytest.mark.usefixtures("tool")
def test_the_action_writes_a_report_and_fails_all_the_same(job: Path) -> None:
    done = run_step("Check", job, format="sarif", output="found.sarif")
    assert (done.returncode, done.stdout, done.stderr) == (1, "", "")
    report = yaml.safe_load((job / "found.sarif").read_text())
    assert {result["ruleId"] for result in report["runs"][0]["results"]} == {"SF101"}


@pytest.mark.skipif("fmt" not in COMMANDS, reason="needs the formatter")
@pytest.mark.usefixtures("tool")
def test_the_action_fails_for_another_form_where_it_is_asked_to(job: Path) -> None:
    (job / "good.scene.yaml").write_text(GOOD.replace("name: good", "name:   good"))
    assert run_step("Check", job, paths="good.scene.yaml").returncode == 0
    assert run_step("Check", job, paths="good.scene.yaml", fmt="true").returncode == 1


def test_the_action_installs_itself_or_the_version_that_it_is_given(job: Path) -> None:
    program(job.parent / "bin", "python", RECORDER)
    assert run_step("Install", job).returncode == 0
    installed = (job / "record").read_text().splitlines()
    assert installed[:3] == ["-m", "pip", "install"] and installed[-2:] == [
        "/the action/constraints.txt",
        "/the action",
    ]
    assert run_step("Install", job, version="0.1.0").returncode == 0
    assert (job / "record").read_text().splitlines()[-1] == "simfoundry==0.1.0"
