"""Variants from models through the command: the paper's prompts to servers here, meshes back, cousins out."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

pytest.importorskip("pydantic_ai", reason="the extra `vlm` is not installed")

from simfoundry.scene.lower import lower
from simfoundry.spec.load import load_scene
from tests.cli.command import Done, run
from tests.cousins.conftest import TABLE
from tests.cousins.model_servers import served

RECIPE = """\
simfoundry: cousins/1
name: made
twin: table.scene.yaml
object:
  objects: {cup: {sources: [model], count: 2}}
  models: {vlm: 'openai-chat:seer', images: painter, texture: false}
"""
KEYS = ("SIMFOUNDRY_IMAGES_URL", "SIMFOUNDRY_IMAGES_MODEL", "SIMFOUNDRY_IMAGES_KEY", "SIMFOUNDRY_MESHES_URL")


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "simfoundry.yaml").write_text("")
    (tmp_path / "table.scene.yaml").write_text(TABLE.replace("can", "cup"))
    (tmp_path / "made.cousins.yaml").write_text(RECIPE)
    for name in (*KEYS, "OPENAI_API_KEY", "OPENAI_BASE_URL"):
        monkeypatch.delenv(name, raising=False)
    return tmp_path


def at(url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in {
        "OPENAI_BASE_URL": f"{url}/v1",
        "OPENAI_API_KEY": "mine",
        "SIMFOUNDRY_IMAGES_URL": f"{url}/v1",
        "SIMFOUNDRY_MESHES_URL": url,
    }.items():
        monkeypatch.setenv(name, value)


def made(project: Path, *more: str) -> Done:
    recipe = project / "made.cousins.yaml"
    return run("cousins", recipe, "-n", "2", "-o", project / "out", "-j", "1", "--no-gallery", *more)


@pytest.mark.slow  # 4 s: two whole runs
def test_a_recipe_asks_the_models_and_goes_on_without_them(project: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with served() as (url, models):
        at(url, monkeypatch)
        done = made(project)
        assert done.code == 0, done.err
        paths = [path for path, _ in models.asked]
        prompts = [text for path, text in models.asked if path == "/v1/chat/completions"]
        assert prompts[0].startswith("1 With the given object image, decompose"), "A, with a picture of the thing"
        assert prompts[1].startswith("1 For the body of"), "B"
        assert "through Topological dimension" in prompts[2] and "Topological" not in prompts[4], "C; no for the rim"
        assert prompts[5].startswith("2 You will see a scene image"), "E, with the scene and the new picture"
        edits = [text for path, text in models.asked if path == "/v1/images/edits"]
        assert edits[0].startswith("painter: Modify the following component of the object: 'body'."), "D"
        assert "Apply this geometry variation: a wider body." in edits[0] and "a rim that flares outward" in edits[1]
        assert {text for path, text in models.asked if path == "/generate"} == {"PNG False"}
        assert paths.count("/generate") >= 2
    record = json.loads((project / "out" / "assets" / "objects" / "cup.variants.json").read_text())
    assert [one["source"] for one in record["accepted"]] == ["model", "model"]
    assert record["accepted"][0]["changed"] == ["body, geometry: a wider body"]
    for path in sorted((project / "out").glob("*.scene.yaml")):
        cup = lower(load_scene(path)).object("cup")
        assert cup.root.colliders and "objects/cup_" in path.read_text()
    before = {p: p.read_bytes() for p in (project / "out").rglob("*.yaml")}
    again = made(project)
    assert again.code == 0, "the models are gone, and what they made is there"
    assert {p: p.read_bytes() for p in (project / "out").rglob("*.yaml")} == before


def test_what_is_missing_is_one_sentence(project: Path) -> None:
    recipe = project / "made.cousins.yaml"
    recipe.write_text(
        recipe.read_text().replace("  models: {vlm: 'openai-chat:seer', images: painter, texture: false}\n", "")
    )
    done = made(project)
    assert done.code == 1
    assert done.one_line("impossible: `cup` has the source `model`", "specify --vlm, or `vlm` in the recipe's `models`")
    assert done.one_line("set SIMFOUNDRY_IMAGES_URL and SIMFOUNDRY_IMAGES_MODEL", "set SIMFOUNDRY_MESHES_URL")
    told = made(project, "--vlm", "openai-chat:seer")
    assert told.code == 1 and "--vlm" not in told.err and "SIMFOUNDRY_MESHES_URL" in told.err


@pytest.mark.slow  # 3 s
@pytest.mark.parametrize(
    ("down", "said"),
    [
        ("/v1/chat/completions", "status 400: no such model"),
        ("/v1/images/edits", "the image model at"),
        ("/generate", "the mesh model at"),
    ],
)
def test_a_model_that_is_down_ends_the_run(
    project: Path, monkeypatch: pytest.MonkeyPatch, down: str, said: str
) -> None:
    """After a few candidates, not after all that there might be."""
    with served(frozenset({down})) as (url, _):
        at(url, monkeypatch)
        monkeypatch.setattr("simfoundry.models.generators.TIMEOUT_S", 5.0)
        done = made(project)
    assert done.code == 2 and said in done.err and len(done.err.splitlines()) == 1, done.err
    assert not (project / "out" / "assets" / "objects" / "cup.variants.json").exists(), "it is asked again next time"
