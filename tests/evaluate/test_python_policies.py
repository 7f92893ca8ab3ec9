"""Policies of one's own as Python classes: what they may be, what they do wrong, and that they resume like others."""

from __future__ import annotations

import contextlib
import json
import shlex
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from simfoundry.evaluate.entries import open_policy, parse_policy
from simfoundry.evaluate.policies.base import PolicyError
from simfoundry.evaluate.policies.serve import serve
from tests.cli.command import run
from tests.conftest import REPOSITORY
from tests.evaluate.benches import TASK, write_bench
from tests.evaluate.exchange import running

POLICIES = """
import numpy as np

class Push:
    action_space = "joint_position"

    def __init__(self, step=0.006, bad=""):
        self.step, self.bad = step, bad

    def reset(self, instruction, seed):
        self.seed, self.at = seed, 0.05
        print("beginning", instruction)

    def infer(self, observation):
        if self.bad and self.seed % 2:
            return {"nan": np.full((1, 3), np.nan), "shape": np.zeros((2, 7)), "text": "go"}[self.bad]
        reach = np.minimum(self.at + self.step * np.arange(1, 9), 0.22)
        self.at = reach[-1]
        return np.column_stack([np.zeros(8), reach, np.zeros(8)])

class Blind:
    def infer(self, observation):
        return observation

class Broken(Push):
    def __init__(self):
        raise FileNotFoundError("no checkpoint")

def make(step=0.006):
    return Push(step)
"""


@pytest.fixture
def here(tmp_path: Path) -> Iterator[Path]:
    """The bench in the current folder, with a module of policies beside it."""
    write_bench(tmp_path, TASK.replace("goal: At(block, 0.45, 0)", "goal: Touching(arm, block)", 1))
    (tmp_path / "own_policies.py").write_text(POLICIES)
    path = list(sys.path)
    with contextlib.chdir(tmp_path):
        yield tmp_path
    sys.path[:] = path
    sys.modules.pop("own_policies", None)


def _results(out: Path) -> dict[str, Any]:
    return dict(json.loads((out / "results.json").read_text()))


def test_a_class_is_evaluated_resumed_and_filmed(here: Path) -> None:
    command = ("eval", "push.task.yaml", "-p", "python:own_policies:Push?step=0.008", "-n", "2", "-o", "out", "--json")
    first = run(*command)
    assert first.code == 0, first.err
    assert json.loads(first.out)["scores"][0]["successes"] == 2  # what it prints is not between the figures
    assert (here / "out/rollouts/push/Push/mujoco/001.webm").is_file()
    before = {p: p.stat().st_mtime_ns for p in (here / "out/rollouts").rglob("*")}
    assert run(*command, "-j", "2").code == 0
    assert {p: p.stat().st_mtime_ns for p in (here / "out/rollouts").rglob("*")} == before
    (here / "own_policies.py").write_text(POLICIES + "# edited\n")
    again = run(*command)
    assert again.code == 2 and "a different evaluation: its policy (its document, recording or code) is" in again.out


@pytest.mark.parametrize(
    ("bad", "said"),
    [
        ("nan", "number 0 of action 0 (joint 1 of `arm`) is nan"),
        ("shape", "got (2, 7)"),
        ("text", "must be an array of numbers"),
        ("error", "Push failed: KeyError: 'error' (own_policies.py:16)"),
    ],
)
def test_an_invalid_answer_is_a_failed_rollout(here: Path, bad: str, said: str) -> None:
    result = run(
        "eval", "push.task.yaml", "-p", f"python:own_policies.py:Push?bad={bad}", "-n", "4", "-o", "out", "--no-video"
    )
    assert result.code == 0, result.err
    assert "2/4  50% (15% to 85%), 2 with an invalid response" in result.out
    assert "rollout 1 counts as failed" in result.err and said in result.err
    found = _results(here / "out")
    (score,) = found["scores"]
    assert (score["successes"], score["rollouts"], score["invalid"], score["missing"]) == (2, 4, 2, 0)
    assert [r["end"] for r in found["rollouts"]] == ["success", "invalid answer"] * 2
    assert (
        run("eval", "push.task.yaml", "-p", f"python:own_policies.py:Push?bad={bad}", "-n", "4", "-o", "out").code == 0
    )


def test_a_file_never_stands_in_the_place_of_a_package(here: Path) -> None:
    for folder in ("a", "b"):
        (here / folder).mkdir()
        (here / folder / "numpy.py").write_text("import numpy\nARRAY = numpy.zeros(2)\n" + POLICIES)
        (here / folder / "beside.py").write_text("")
    policies = [f"{f}=python:{f}/numpy.py:Push" for f in ("a", "b")]
    command = ("eval", "push.task.yaml", "-p", policies[0], "-p", policies[1], "-n", "1", "-o", "out", "--no-video")
    result = run(*command)
    assert result.code == 0 and sys.modules["numpy"] is np, result.err


def test_what_is_no_policy_is_said_before_the_first_rollout(here: Path) -> None:
    (here / "wrong.py").write_text("import nothing_of_this_name\n")
    (here / "syntax.py").write_text("class A(:\n")
    for text, said in [
        ("python:own_policies", "does not name a class; use `python:MODULE:CLASS`"),
        ("python:own_policies:Psh", "has no `Psh`; available classes: Push, Blind, Broken"),
        ("python:absent:Push", "module `absent` was found neither"),
        ("python:absent.py:Push", "file absent.py does not exist"),
        (
            "python:wrong:Push",
            "wrong.py: ModuleNotFoundError: No module named 'nothing_of_this_name'",
        ),
        ("python:syntax:Push", "syntax.py: SyntaxError"),
        ("python:own_policies:np", "is a `module`, not a class"),
        ("python:own_policies:Push?1=2", "does not contain valid arguments for `Push`"),
    ]:
        result = run("eval", "push.task.yaml", "-p", text, "-n", "1", "-o", "out")
        assert result.code == 2 and said in result.err, (text, result.err)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("Blind", "`Blind` has `action_space` None: unknown action space `None`; available: joint_position"),
        ("Broken", r"could not create .*: FileNotFoundError: no checkpoint \(own_policies.py:\d+\)"),
        ("Push?steps=3", r"could not create .*: TypeError: .*unexpected keyword argument 'steps'"),
    ],
)
@pytest.mark.usefixtures("here")
def test_a_class_that_cannot_act_says_why(text: str, said: str) -> None:
    with pytest.raises(PolicyError, match=said):
        open_policy(parse_policy(f"python:own_policies:{text}"))  # type: ignore[arg-type]


@pytest.mark.usefixtures("here")
def test_a_function_may_make_the_policy() -> None:
    policy = open_policy(parse_policy("python:own_policies:make?step=0.01"))  # type: ignore[arg-type]
    policy.reset("", 0)
    assert policy.infer(None)[0, 1] == pytest.approx(0.06)  # type: ignore[arg-type]
    assert isinstance(np.asarray(policy.infer(None)), np.ndarray)  # type: ignore[arg-type]


def _block(mark: str) -> str:
    """The code block of docs/policies.md that holds a line."""
    blocks = (REPOSITORY / "docs/policies.md").read_text().split("```")
    (found,) = [block.partition("\n")[2] for block in blocks if mark in block and block.startswith(("python", "yaml"))]
    return found


def test_the_class_of_the_documentation(here: Path) -> None:
    (here / "my_policy.py").write_text(_block("# my_policy.py"))
    (command,) = [c for c in (REPOSITORY / "docs/policies.md").read_text().splitlines() if "fast=python:" in c]
    result = run(*shlex.split(command)[1:], "-n", "1", "-o", "out", "--no-video")
    assert result.code == 0 and "1/1" in result.out and "Reach" in result.out and "fast" in result.out, result.err


def test_the_server_of_the_documentation_and_what_it_answers_wrongly(here: Path) -> None:
    made: dict[str, Any] = {"__name__": "my_server"}
    exec(compile(_block("# my_server.py"), "docs/policies.md", "exec"), made)

    def infer(observation: Mapping[str, Any]) -> Mapping[str, Any]:
        seen.append(observation["prompt"])
        actions = np.array(made["infer"](observation)["actions"])
        return {"actions": actions * np.nan if len(seen) % 2 else actions}

    seen: list[str] = []
    with running(serve(infer, {"name": "half"}, port=0)) as address:
        document = _block("name: my_policy\n").replace("localhost:8000", address)
        (here / "my_policy.policy.yaml").write_text(document)
        command = ("eval", "push.task.yaml", "-p", "my_policy.policy.yaml", "-n", "2", "-o", "out", "--no-video")
        result = run(*command)
        assert result.code == 0 and "0/2" in result.out and "2 with an invalid response" in result.out, result.err
        assert "the actions of my_policy must be finite; number 0 of action 0 (joint 1 of `arm`) is nan" in result.err
