"""What a model states about the objects of an image: which segment it means, and what becomes of it in the scene."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest
import yaml
from PIL import Image

from simfoundry.capture.scene_reading import match_objects
from simfoundry.models.provenance import ModelIdentity
from simfoundry.models.tasks.scenes import SceneEstimate, SceneReading, SeenObject
from tests.cli.command import run
from tests.conftest import REPOSITORY

MAKER = ModelIdentity(name="reader", version="1", licence="MIT", commercial=True)


def seen(phrase: str, box: tuple[float, float, float, float] | None) -> SeenObject:
    return SeenObject(phrase=phrase, category="mug", box=box)


def test_objects_are_matched_by_their_boxes() -> None:
    labels = np.zeros((40, 60), np.int32)
    labels[5:15, 5:15], labels[5:25, 30:50] = 1, 2
    objects = (
        seen("big", (28, 4, 52, 27)),
        seen("small", (4, 4, 17, 16)),
        seen("also big", (29, 0, 60, 40)),
        seen("ghost", (0, 30, 10, 40)),
        seen("somewhere", None),
    )
    read = match_objects(SceneEstimate(SceneReading(objects=objects), MAKER), labels)
    assert {k: each.phrase for k, each in read.objects.items()} == {1: "small", 2: "big"}
    assert [each.phrase for each in read.unmatched] == ["also big", "ghost"]
    assert read.name(1) == "small" and read.name(3) is None
    nothing = match_objects(SceneEstimate(SceneReading(objects=objects), MAKER), np.zeros((4, 4), np.int32))
    assert not nothing.objects and len(nothing.unmatched) == 4


SERVER = """
import json, sys
sys.path.insert(0, {folder!r})
from scaffold import Model, RefusedError, Result, run

def read_scene(request):
    objects = json.loads({objects!r})
    if not objects:
        raise RefusedError("the weights are missing")
    return Result({{}}, values={{"objects": objects, "support": "desk"}})

facts = {{"name": "reader", "version": "1", "licence": "MIT", "commercial": {commercial}}}
sys.exit(run(Model(facts, {{"read_scene": read_scene}})))
"""


def answering(folder: Path, objects: Sequence[Mapping[str, object]], commercial: bool = True) -> str:
    """Write a server that answers with the given objects, and return how it is configured."""
    server = folder / "serve.py"
    servers = str(REPOSITORY / "examples" / "servers")
    server.write_text(SERVER.format(folder=servers, objects=json.dumps(objects), commercial=commercial))
    return f"command:{sys.executable} {server}"


@pytest.mark.slow  # 2 s
def test_a_model_names_objects_in_the_scene(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    labels = np.array(Image.open(folder / "out" / "segments.png"))
    rows, columns = np.nonzero(labels == 1)
    box = [int(columns.min()), int(rows.min()), int(columns.max()) + 1, int(rows.max()) + 1]
    soap = {"phrase": "Bar of soap", "category": "Soap bar", "material": "smooth plastic", "box": box, "mass": 0.12}
    ghost = {"phrase": "wine glass", "category": "glass", "box": [0, 0, 9, 20]}
    (folder / "capture" / "capture.yaml").write_text(_without_names((folder / "capture" / "capture.yaml").read_text()))
    monkeypatch.setenv("SIMFOUNDRY_MODEL_READ_SCENE", answering(tmp_path, [soap, ghost]))
    out = tmp_path / "out"
    first = run("capture", folder / "capture", "-o", out, "--json")
    assert first.code in (0, 1), first.err
    scene = yaml.safe_load(next(out.glob("*.scene.yaml")).read_text())
    made = scene["objects"]["bar_of_soap"]
    assert made["category"] == "soap_bar" and made["material"] == "plastic"
    assert made["mass"] == {"value": 0.12, "range": [0.06, 0.24], "source": "reader"}
    assert made["origin"]["models"][0]["task"] == "read_scene"
    findings = [each for each in json.loads(first.out)["findings"] if each["code"] == "SF641"]
    assert "`wine glass`" in findings[0]["message"] and findings[0]["place"] == "pixels [0, 0] to [9, 20]"
    states = {(each["stage"], each["state"]) for each in json.loads(first.out)["stages"]}
    assert ("read", "ran") in states
    # The answer is kept, so that the model need not be there for the next run.
    (tmp_path / "serve.py").write_text("raise SystemExit(1)")
    again = run("capture", folder / "capture", "-o", out, "--json")
    assert {(s["stage"], s["state"]) for s in json.loads(again.out)["stages"]} >= {("read", "cached")}
    assert "stale" not in run("capture", "status", out).out


@pytest.mark.slow  # 2 s
def test_without_an_answer_the_rest_goes_on(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SIMFOUNDRY_MODEL_READ_SCENE", answering(tmp_path, []))
    failed = run("capture", folder / "capture", "-o", tmp_path / "out", "--json")
    assert failed.code == 1, failed.err
    (finding,) = [each for each in json.loads(failed.out)["findings"] if each["code"] == "SF640"]
    assert "the weights are missing" in finding["message"]
    accepted = run("capture", folder / "capture", "-o", tmp_path / "out", "--accept", "SF640", "--json")
    assert next(e["accepted"] for e in json.loads(accepted.out)["findings"] if e["code"] == "SF640")
    monkeypatch.setenv("SIMFOUNDRY_MODEL_READ_SCENE", answering(tmp_path, [{"phrase": "a", "category": "b"}], False))
    refused = run("capture", folder / "capture", "-o", tmp_path / "out", "--commercial-only", "--json")
    messages = [each["message"] for each in json.loads(refused.out)["findings"] if each["code"] == "SF640"]
    assert refused.code == 1 and "may not be used commercially" in messages[0]


def _without_names(text: str) -> str:
    data = yaml.safe_load(text)
    for frame in data["frames"].values():
        frame.get("masks", {}).pop("names", None)
    return yaml.safe_dump(data)
