"""What docs/cousins.md shows of other objects is run: each of its three sources, and what it says where models lack."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import pytest

from simfoundry.spec.load import load
from simfoundry.spec.models.scene import SceneSpec
from tests.cli.command import Done, run
from tests.conftest import REPOSITORY
from tests.cousins.model_servers import served

PAGE = (REPOSITORY / "docs" / "cousins.md").read_text()
AXES = {
    source: next(
        text for text in re.findall(r"^```yaml\n(object:.*?)^```", PAGE, re.DOTALL | re.MULTILINE) if mark in text
    )
    for source, mark in (("rules", "components"), ("library", "library:"), ("models", "models:"))
}
"""The axes that the page shows."""

HEAD = "simfoundry: cousins/1\nname: page\ntwin: ../scenes/cup_in_bowl.scene.yaml\n"


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for name in ("IMAGES_URL", "IMAGES_MODEL", "IMAGES_KEY", "MESHES_URL"):
        monkeypatch.delenv(f"SIMFOUNDRY_{name}", raising=False)
    for folder in ("scenes", "assets"):
        shutil.copytree(REPOSITORY / "specs" / folder, tmp_path / "specs" / folder)
    (tmp_path / "specs" / "cousins").mkdir()
    (tmp_path / "simfoundry.yaml").write_text("")
    return tmp_path


def made(project: Path, axis: str, count: int) -> Done:
    recipe = project / "specs" / "cousins" / "page.cousins.yaml"
    recipe.write_text(HEAD + axis)
    return run("cousins", recipe, "-n", str(count), "-o", project / "out", "-j", "1", "--no-gallery")


def assets(project: Path, name: str) -> set[str]:
    """The documents that the cousins have for an object; all of them are without findings."""
    found = set()
    for path in (project / "out").glob("*.scene.yaml"):
        loaded = load(path)
        assert loaded.all_findings() == [] and isinstance(loaded.spec, SceneSpec)
        found.add(str(loaded.spec.objects[name].asset))
    return found


@pytest.mark.slow  # 2 s
def test_fewer_variants_than_asked_for_are_said_and_end_with_1(project: Path) -> None:
    """All cousins are made, of fewer cups than the recipe asks for: a cup of one material in one color is one cup."""
    axis = "object:\n  objects: {cup: {sources: [library], count: 3}}\n  library: ../assets\n"
    done = made(project, axis, 1)
    assert done.code == 1, done
    assert done.out.startswith("1 of 1 cousins")
    assert "variants of `cup`: 2 of 3 generated from " in done.err and "for example: " in done.err, done.err
    manifest = json.loads((project / "out" / "manifest.json").read_bytes())
    assert manifest["variants"]["cup"] | {"reasons": {}} == {
        "asked": 3, "made": 2, "candidates": manifest["variants"]["cup"]["candidates"], "reasons": {},
    }  # fmt: skip
    assert sum(manifest["variants"]["cup"]["reasons"].values()) == manifest["variants"]["cup"]["candidates"] - 2


@pytest.mark.slow  # 2 s
def test_by_rules(project: Path) -> None:
    done = made(project, AXES["rules"], 2)
    assert done.code == 0, done.err
    assert len(assets(project, "cup")) == 2 and len(assets(project, "bowl")) == 1


def test_from_a_library(project: Path) -> None:
    done = made(project, AXES["library"], 2)
    assert done.code == 0, done.err
    assert all("library" in (project / "out" / name).read_text() for name in assets(project, "cup"))


@pytest.mark.slow  # 3 s: a whole run
def test_from_models(project: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pydantic_ai", reason="the extra `vlm` is not installed")
    needs = re.search(r"^impossible: `cup` has the source `model`.*$", PAGE, re.MULTILINE)
    assert needs is not None
    missing = made(project, AXES["models"], 1).err
    assert missing.startswith(f"{needs[0]}; `openai-chat:my-vlm` cannot be used: Set the `OPENAI_API_KEY`"), missing
    with served() as (url, models):
        for name, value in {
            "OPENAI_BASE_URL": f"{url}/v1",
            "OPENAI_API_KEY": "mine",
            "SIMFOUNDRY_IMAGES_URL": f"{url}/v1",
            "SIMFOUNDRY_MESHES_URL": url,
        }.items():
            monkeypatch.setenv(name, value)
        done = made(project, AXES["models"], 1)
    assert done.code == 0, done.err
    assert {path for path, _ in models.asked} == {"/v1/chat/completions", "/v1/images/edits", "/generate"}
