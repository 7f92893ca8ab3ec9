"""A predicate of an installed package works wherever ours do."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from simfoundry.predicates import Judge
from simfoundry.scene.lower import lower_file
from simfoundry.scene.state import SceneState
from simfoundry.spec.models.predicate import ExpressionError, parse_call
from tests.cli.command import MAIN
from tests.conftest import REPOSITORY
from tests.foreign_package import write_package

HIGHER = """
from simfoundry.spec.models.predicate import Effect, Predicate


def higher(terms, a, b, rise=0.0):
    off = terms.view.heights(a)[0] - terms.view.heights(b)[0] - rise
    terms.require(off, off, lambda v, ok: f"`{a.name}` is {v:.2f} m higher than `{b.name}`")


HIGHER = Predicate(
    "Higher", "the first is higher", ("thing", "thing", "number"), higher, "its lowest point is higher",
    optional=1, effect=Effect.GRASP, aliases=("higher_than",),
)
"""
SCENE = """\
simfoundry: scene/1
name: steps
objects:
  a: {shape: {box: [0.05, 0.05, 0.05]}, mass: 0.1, pose: {xyz: [0, 0, 0.5]}}
  b: {shape: {box: [0.05, 0.05, 0.05]}, mass: 0.1, pose: {xyz: [0.2, 0, 0.1]}}
robots: {arm: {model: franka_robotiq, pose: {xyz: [-0.4, 0, 0]}}}
relations: ["Higher(a, b, 0.2)", "higher_than(a, b)"]
"""
TASK = """\
simfoundry: task/1
name: swap
scene: steps.scene.yaml
instruction: raise b
goal: Higher(b, a)
horizon: 100
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A project, with a package `rise` installed beside it that brings the predicate."""
    entry_points = {"simfoundry.predicates": {"Higher": "rise:HIGHER"}}
    write_package(tmp_path / "site", "rise", entry_points, {"rise.py": HIGHER})
    (tmp_path / "steps.scene.yaml").write_text(SCENE)
    (tmp_path / "swap.task.yaml").write_text(TASK)
    return tmp_path


def command(folder: Path, *arguments: str) -> str:
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(folder / "site"), str(REPOSITORY)])}
    done = subprocess.run(
        [sys.executable, "-c", MAIN, *arguments], cwd=folder, env=environment, capture_output=True, text=True
    )
    assert done.stderr == "" and done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_commands_know_it(folder: Path) -> None:
    assert "no finding" in command(folder, "check", "steps.scene.yaml", "swap.task.yaml")
    assert "Higher(a, b): `a` is 0.40 m higher than `b`" in command(folder, "judge", "steps.scene.yaml")
    assert "Higher(a, b)" in command(folder, "fmt", "--diff", "steps.scene.yaml")


def test_it_is_read_and_judged(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ExpressionError, match="`Higher` is not a predicate"):
        parse_call("Higher(a, b)")
    monkeypatch.syspath_prepend(folder / "site")
    assert str(parse_call("higher_than(a, b)")) == "Higher(a, b)"
    with pytest.raises(ExpressionError, match="`Higher` takes 2 or 3 arguments, not 1"):
        parse_call("Higher(a)")
    scene = lower_file(folder / "steps.scene.yaml")
    verdict = Judge(scene)({"not": "Higher(b, a)"}, SceneState.initial(scene))
    assert verdict.value and verdict.margin == pytest.approx(0.4)


def test_a_broken_one_is_a_finding(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (folder / "site" / "rise.py").write_text("HIGHER = 1\n")
    monkeypatch.syspath_prepend(folder / "site")
    monkeypatch.delitem(sys.modules, "rise", raising=False)
    words = r"`Higher` predicate from the package rise 0\.1 cannot be loaded: .* is a int"
    with pytest.raises(ExpressionError, match=words):
        parse_call("Higher(c, d)")
