"""``--commercial-only`` in each command that asks models: the refused ones are named, and nothing is sent to them."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from simfoundry.cousins.objects.generation import SourceSetup
from simfoundry.cousins.recipe.variant_pool import made_for
from simfoundry.models.contract import ModelError
from simfoundry.spec.load import load_kind
from simfoundry.spec.models.cousins import ObjectAxis, ObjectVariants
from tests.cli.command import run
from tests.conftest import REPOSITORY
from tests.cousins.conftest import TABLE
from tests.models.test_cousins_use_models import DOORS

TASK = "simfoundry: task/1\nname: t\nscene: table.scene.yaml\ninstruction: Move it.\ngoal: OnTop(chip, post)\n"
RECIPE = """\
simfoundry: cousins/1
name: r
twin: t.task.yaml
object: {objects: {chip: {count: 1, sources: [model]}}, models: {vlm: test}}
"""


@pytest.fixture
def recipe(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a recipe that needs three models, all configured, of which none may be used commercially."""
    for name, value in DOORS.items():
        monkeypatch.setenv(name, value)
    (tmp_path / "table.scene.yaml").write_text(TABLE)
    (tmp_path / "t.task.yaml").write_text(TASK)
    path = tmp_path / "r.cousins.yaml"
    path.write_text(RECIPE)
    return path


def test_cousins_name_each_refused_model(recipe: Path) -> None:
    out = recipe.parent / "out"
    made = run("cousins", recipe, "-o", out, "--commercial-only")
    assert made.code == 1 and "Traceback" not in made.err
    line = made.one_line("impossible: `chip` has the source `model`", "painter has no known licence")
    assert "hunyuan3d-2 may be used commercially only under a condition" in line and "test has no known licence" in line


def test_training_names_each_refused_model(recipe: Path) -> None:
    pytest.importorskip("torch")
    trained = run("train", recipe, "-o", recipe.parent / "out" / "train", "--commercial-only")
    assert trained.code == 2 and "painter has no known licence" in trained.err and "Traceback" not in trained.err


def test_a_model_that_proposes_tasks_is_refused(recipe: Path) -> None:
    asked = run("propose", recipe.parent / "table.scene.yaml", "--vlm", "test", "--commercial-only")
    assert asked.code == 2 and asked.one_line("test has no known licence for commercial use", "omit --commercial-only")


def test_articulate_refuses_a_model_of_depth(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    identity = {"name": "DA3NESTED-GIANT-LARGE", "version": "1.1", "licence": "CC-BY-NC-4.0"}
    about = {"bundle": 1, "tasks": {"depth": {"model": identity}}}
    script = tmp_path / "serve.py"
    script.write_text(f"import sys\nassert sys.argv[1:] == ['--describe']\nprint({json.dumps(about)!r})\n")
    monkeypatch.setenv("SIMFOUNDRY_MODEL_DEPTH", f"command:{sys.executable} {script}")
    folders = []
    for name in ("shut", "opened"):
        folder = tmp_path / name
        folder.mkdir()
        _photo(folder / "color.png")
        camera = "{fx: 60, fy: 60, cx: 31.5, cy: 23.5}"
        (folder / "capture.yaml").write_text(
            f"simfoundry: capture/1\nname: {name}\nframes:\n  f:\n    color: color.png\n    camera: {camera}\n"
        )
        folders.append(folder)
    out = tmp_path / "a.asset.yaml"
    refused = run("articulate", *folders, "-o", out, "--commercial-only")
    assert refused.code == 2 and not out.exists()
    refused.one_line("DA3NESTED-GIANT-LARGE may not be used commercially")


def _photo(path: Path) -> None:
    from PIL import Image

    Image.new("RGB", (64, 48), (120, 90, 60)).save(path)


def test_variants_of_an_earlier_run_are_held_to_it(tmp_path: Path) -> None:
    table = load_kind(REPOSITORY / "specs" / "scenes" / "clear_table.scene.yaml", "scene/1")
    axis = ObjectAxis(objects={"cube": ObjectVariants(count=1)})
    (file,) = made_for(axis, table, [], 0, tmp_path, SourceSetup(table.path))["cube"]
    use = "{task: mesh, name: partfield, version: '1', licence: NVIDIA, commercial: forbidden}"
    head, note, rest = file.read_text().partition("  note: ")
    file.write_text(f"{head}  models: [{use}]\n{note}{rest}")
    record = tmp_path / "cube.variants.json"
    record.write_text(record.read_text().replace('"source": "procedural"', '"source": "model"'))
    assert made_for(axis, table, [], 0, tmp_path, SourceSetup(table.path))["cube"] == (file,)
    strict = SourceSetup(table.path, commercial_only=True)
    with pytest.raises(ModelError, match=rf"{file} was made earlier .*partfield may not be used commercially"):
        made_for(axis, table, [], 0, tmp_path, strict)
