"""Scenes for the tests of lints, written into a folder and linted."""

from __future__ import annotations

import textwrap
from pathlib import Path

from simfoundry.lint.draft import DraftScene, drafted
from simfoundry.lint.lints import lint
from simfoundry.spec.diagnostics import Diagnostic
from simfoundry.spec.load import load

DESK = "  desk: {fixed: true, shape: {box: [2, 2, 0.04]}, pose: {xyz: [0, 0, -0.02]}}\n"
BOWL = "shape: {lathe: {profile: [[0, 0], [0.05, 0], [0.08, 0.06], [0.075, 0.06], [0.046, 0.005], [0, 0.005]]}}"
ARM = "robots: {arm: {model: franka_robotiq}}\n"


def written(folder: Path, objects: str, more: str = "", name: str = "desk.scene.yaml") -> Path:
    """A scene with a desk whose top is at z = 0, and ``objects`` (lines of YAML) on it."""
    (folder / "simfoundry.yaml").touch()
    path = folder / name
    body = textwrap.indent(textwrap.dedent(objects).strip("\n"), "  ")
    path.write_text(f"simfoundry: scene/1\nname: desk\nobjects:\n{DESK}{body}\n{more}")
    return path


def findings(path: Path) -> list[Diagnostic]:
    """What the lints find in a document without errors."""
    loaded = load(path)
    assert loaded.errors == [], loaded.errors
    return list(lint(loaded))


def found(path: Path) -> list[tuple[str, str]]:
    """Code and message of each."""
    return [(d.code, d.message) for d in findings(path)]


def codes(path: Path) -> list[str]:
    """The codes of what the lints find."""
    return [d.code for d in findings(path)]


def draft(path: Path) -> DraftScene:
    """The scene as lints judge it."""
    loaded = load(path)
    assert loaded.errors == [], loaded.errors
    return drafted(loaded)


def task(folder: Path, goal: str, more: str = "", name: str = "task.task.yaml") -> Path:
    """A task beside the scene that :func:`written` writes."""
    path = folder / name
    text = "simfoundry: task/1\nname: task\nscene: desk.scene.yaml\ninstruction: Do it.\n"
    path.write_text(f"{text}goal: {goal}\n{more}")
    return path
