"""A scene to a build folder: all targets or nothing, the same bytes twice, and one report of losses."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import pytest

from simfoundry.backends.artifact import Artifact
from simfoundry.errors import OutputError
from simfoundry.scene.model import Scene
from simfoundry.targets.compile import compile_target
from simfoundry.targets.find import Target
from simfoundry.targets.report import report
from simfoundry.worlds import build as module
from simfoundry.worlds.build import TARGETS, build
from tests.scenes import full_scene


def content(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def test_every_target_has_its_folder_with_a_manifest_that_is_true(tmp_path: Path) -> None:
    artifacts = build(full_scene(), TARGETS, tmp_path)
    assert [a.target for a in artifacts] == list(TARGETS) == ["mjcf", "pybullet", "urdf", "usd"]
    assert sorted(p.name for p in tmp_path.iterdir()) == ["loss.json", *TARGETS]
    for artifact in artifacts:
        manifest = json.loads((tmp_path / artifact.target / "manifest.json").read_text())
        files = {k: v for k, v in content(tmp_path / artifact.target).items() if k != "manifest.json"}
        assert manifest["files"] == {k: hashlib.sha256(v).hexdigest() for k, v in files.items()}
        assert manifest["entry"] in files
    losses = json.loads((tmp_path / "loss.json").read_text())
    assert {t: len(v["losses"]) for t, v in losses.items()} == {a.target: len(a.losses) for a in artifacts}
    assert json.loads((tmp_path / "loss.json").read_bytes()) == report(full_scene(), artifacts)


def test_building_again_gives_the_same_and_leaves_nothing_behind(tmp_path: Path) -> None:
    build(full_scene(), TARGETS, tmp_path)
    before = content(tmp_path)
    build(full_scene(), [*TARGETS, "usd"], tmp_path)
    assert content(tmp_path) == before


def test_a_target_that_fails_writes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    build(full_scene(), ["mjcf"], tmp_path)
    before = content(tmp_path)

    def failing(scene: Scene, target: Target) -> Artifact:
        if target.name == "usd":
            raise RuntimeError("no")
        return compile_target(scene, target)

    monkeypatch.setattr(module, "compile_target", failing)
    with pytest.raises(RuntimeError):
        build(full_scene(), ["mjcf", "urdf", "usd"], tmp_path)
    assert content(tmp_path) == before


def test_files_of_others_are_kept(tmp_path: Path) -> None:
    (tmp_path / "mjcf").mkdir()
    (tmp_path / "mjcf" / "thesis.tex").write_text("mine")
    with pytest.raises(OutputError, match=r"thesis\.tex"):
        build(full_scene(), ["urdf", "mjcf"], tmp_path)
    assert content(tmp_path) == {"mjcf/thesis.tex": b"mine"}
    build(full_scene(), ["mjcf"], tmp_path, force=True)
    assert "mjcf/scene.xml" in content(tmp_path) and "mjcf/thesis.tex" not in content(tmp_path)


def test_the_command_line_offers_every_backend() -> None:
    """It names them itself, so that its help loads none."""
    from simfoundry.cli.compile import TARGETS as OFFERED

    assert sorted(OFFERED) == list(TARGETS)
