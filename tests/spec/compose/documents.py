"""Scenes for tests of reuse."""

from __future__ import annotations

from pathlib import Path

from simfoundry.spec.diagnostics import ordered, render
from simfoundry.spec.files import Loaded
from simfoundry.spec.load import load
from simfoundry.spec.models.scene import SceneSpec

HEAD = "simfoundry: scene/1\nname: a\n"
DESK = "  desk: {fixed: true, shape: {box: [2, 2, 0.04]}, pose: {xyz: [0, 0, -0.02]}}\n"


def written(folder: Path, body: str, name: str = "a.scene.yaml") -> Path:
    (folder / "simfoundry.yaml").touch()
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(body if body.startswith("simfoundry:") else HEAD + body)
    return path


def loaded(folder: Path, body: str, **more: dict[str, float]) -> Loaded:
    return load(written(folder, body), **more)  # type: ignore[arg-type]


def spec_of(folder: Path, body: str, **more: dict[str, float]) -> SceneSpec:
    found = loaded(folder, body, **more)
    assert isinstance(found.spec, SceneSpec), render(found.all_findings())
    return found.spec


def messages(folder: Path, body: str, **more: dict[str, float]) -> list[str]:
    """The findings in reading order, as line:column, code and message."""
    return [f"{d.line}:{d.column} {d.code} {d.message}" for d in ordered(loaded(folder, body, **more).all_findings())]
