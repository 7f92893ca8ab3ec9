"""A scene to a build folder: all targets or nothing, the same bytes twice, and one report of losses."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import pytest

from simfoundry.backends.artifact import Artifact
from simfoundry.backends.names import InvalidSceneError
from simfoundry.errors import OutputError
from simfoundry.scene.model import Scene
from simfoundry.targets import build as module
from simfoundry.targets.build import TARGETS, TargetsError, build, report
from simfoundry.targets.compile import compile_target
from simfoundry.targets.find import Target
from tests.cli.command import run
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


def test_a_target_that_fails_takes_no_other_with_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    build(full_scene(), ["mjcf", "usd"], tmp_path, record={})
    before = content(tmp_path)

    def failing(scene: Scene, target: Target) -> Artifact:
        if target.name == "usd":
            raise KeyError("base")
        return compile_target(scene, target)

    monkeypatch.setattr(module, "compile_target", failing)
    with pytest.raises(TargetsError) as failed:
        build(full_scene(), ["usd", "mjcf", "urdf"], tmp_path, record={})
    assert [a.target for a in failed.value.artifacts] == ["mjcf", "urdf"]
    assert list(failed.value.failures) == ["usd"]
    assert str(failed.value).startswith("usd is not written: its backend failed: KeyError: 'base' (targets/build.py:")
    after = content(tmp_path)
    assert set(json.loads(after["loss.json"])) == {"mjcf", "urdf"} and "urdf/poses.json" in after
    assert {k: v for k, v in after.items() if k.startswith("usd/")} == {
        k: v for k, v in before.items() if k.startswith("usd/")
    }
    assert "build.json" not in after  # so that the next batch does it again
    with pytest.raises(TargetsError):
        build(full_scene(), ["usd"], tmp_path / "alone")
    assert not (tmp_path / "alone").exists()


def test_compile_says_which_target_failed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "one.scene.yaml"
    file.write_text("simfoundry: scene/1\nname: one\nobjects:\n  ball: {shape: {sphere: 0.1}, mass: 1}\n")

    def failing(scene: Scene, target: Target) -> Artifact:
        if target.name == "usd":
            raise InvalidSceneError("the scene: two cameras are called 'eye'; rename one")
        return compile_target(scene, target)

    monkeypatch.setattr(module, "compile_target", failing)
    done = run("compile", file, "-o", tmp_path / "build", "-t", "usd", "-t", "mjcf")
    assert done.code == 1 and "usd is not written: the scene: two cameras are called 'eye'; rename one" in done.err
    assert (tmp_path / "build" / "mjcf" / "scene.xml").is_file() and not (tmp_path / "build" / "usd").exists()
    assert run("compile", file, "-o", tmp_path / "build", "-t", "usd").code == 2
    both = run("compile", file, file.parent, "-o", tmp_path / "many", "-t", "usd", "-t", "mjcf")
    assert both.code == 1 and "usd is not written" in both.err


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
