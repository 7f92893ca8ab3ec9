"""Where models are configured, which of them answer, and which may be used commercially."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any, get_args

import pytest
from click.testing import CliRunner
from scaffold import Model

from simfoundry.cli.main import app
from simfoundry.models.contract import ModelError
from simfoundry.models.inventory import inventory, lines
from simfoundry.models.open import OFFLINE, open_model
from simfoundry.models.provenance import ModelIdentity, find_licence, judged, licences, require_commercial
from simfoundry.models.setup import ModelSetup, load_setup
from simfoundry.models.tasks.masks import BundleMasks, SegmentationPrompt
from simfoundry.models.tasks.registry import TASKS
from simfoundry.models.transports.http import HttpTransport
from simfoundry.models.transports.process import ProcessTransport
from simfoundry.spec.diagnostics import SpecError
from simfoundry.spec.models.model_sources import ModelTaskName
from tests.models import truth
from tests.models.test_tasks import CALLS, FRAMES, serving
from tests.models.truth import IDENTITY

# What the table must say of the models that the paper and its release use, and of those that replace them.
FORBIDDEN = (
    "DA3NESTED-GIANT-LARGE-1.1", "depth-anything/DA3-GIANT", "DA3-LARGE", "FoundationStereo", "Fast-FoundationStereo",
    "FoundationPose", "Any6D", "PartField", "VGGT-1B", "MASt3R", "CoTracker", "FLUX.1-Kontext-dev",
    "prior-depth-anything", "inria-gaussian-splatting", "particulate",
)  # fmt: skip
ALLOWED = (
    "sam3", "sam3.1", "sam2.1-hiera-large", "da3metric-large", "moge-2-vitl-normal", "c-foundationstereo-s", "lama",
    "c-fast-foundationstereo", "nvidia/foundationpose-tao", "sam-3d-objects", "VGGT-1B-Commercial",
)  # fmt: skip
CONDITIONAL = ("tencent/Hunyuan3D-2.1", "TRELLIS.2-4B", "P3-SAM", "void-model")


def _identity(name: str, commercial: bool | None = True) -> ModelIdentity:
    return ModelIdentity(name=name, version="1", licence="x", commercial=commercial)


def test_the_table_decides_whatever_a_server_claims() -> None:
    assert set(get_args(ModelTaskName)) == set(TASKS) and OFFLINE.keys() < TASKS.keys()
    assert all(set(entry.task) <= set(TASKS) and entry.source for entry in licences().values())
    for name in FORBIDDEN:
        with pytest.raises(ModelError, match="may not be used commercially"):
            require_commercial(_identity(name), accepted=(name,))
    for name in ALLOWED:
        require_commercial(_identity(name))
    for name in CONDITIONAL:
        with pytest.raises(ModelError, match=r"only under a condition: .*`accepted` under `models`"):
            require_commercial(_identity(name))
        require_commercial(_identity(name), accepted=(name,))
    assert judged(_identity("moge-2-my-finetune", commercial=False))[0] == "forbidden"
    assert [judged(_identity("mine", word))[0] for word in (True, False, None)] == ["allowed", "forbidden", "unknown"]
    with pytest.raises(ModelError, match="no known licence"):
        require_commercial(_identity("samesh"))
    assert find_licence("nothing-like-it") is None


def write(folder: Path, text: str) -> Path:
    """Write the configuration of a project."""
    (folder / "simfoundry.yaml").write_text(text)
    return folder


def test_a_project_and_the_environment_name_models(tmp_path: Path) -> None:
    depth, mesh = "{url: 'http://gpu:1', token: SIMFOUNDRY_GPU}", "{command: [python3, serve.py], timeout_s: 7}"
    write(tmp_path, f"models:\n  accepted: [p3-sam]\n  tasks:\n    depth: {depth}\n    mesh: {mesh}\n")
    (tmp_path / "deep").mkdir()
    setup = load_setup(tmp_path / "deep" / "desk.scene.yaml", {"SIMFOUNDRY_GPU": "s"})
    assert setup.client("depth").transport == HttpTransport("http://gpu:1", "s", 300.0)
    assert setup.client("depth").accepted == ("p3-sam",) and not setup.commercial_only
    with pytest.raises(ModelError, match=r"simfoundry\.yaml starts .*python3 serve\.py.* set SIMFOUNDRY_TRUST="):
        setup.client("mesh")
    trusted = load_setup(tmp_path, {"SIMFOUNDRY_TRUST": os.pathsep.join(["/nowhere", str(tmp_path)])})
    assert trusted.client("mesh").transport == ProcessTransport(("python3", "serve.py"), 7.0)
    with pytest.raises(ModelError, match="set the environment variable SIMFOUNDRY_GPU"):
        trusted.client("depth")
    own = load_setup(tmp_path, {"SIMFOUNDRY_MODEL_MESH": "command:a 'b c'", "SIMFOUNDRY_MODEL_DEPTH": "https://x",
                                "SIMFOUNDRY_MODEL_TOKEN": "t", "SIMFOUNDRY_COMMERCIAL_ONLY": "1"})  # fmt: skip
    assert own.client("mesh").transport == ProcessTransport(("a", "b c"), 300.0)
    assert own.client("depth").transport == HttpTransport("https://x", "t", 300.0) and own.commercial_only
    for bad in ("nonsense", "command: ", "command:'", "recorded:", "ftp://x"):
        with pytest.raises(ModelError, match="SIMFOUNDRY_MODEL_POSE"):
            load_setup(tmp_path, {"SIMFOUNDRY_MODEL_POSE": bad})


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("models: {tasks: {dept: {url: 'http://x'}}}", "dept"),
        ("models: {tasks: {depth: {url: 'http://x', offline: true}}}", "only one of"),
        ("models: {tasks: {depth: {timeout_s: 3}}}", "one of .* is needed"),
        ("models: {tasks: {depth: {url: 'file:///etc'}}}", "file:///etc"),
        ("models: {tasks: {depth: {url: 'http://x', token: AWS_SECRET_ACCESS_KEY}}}", "SIMFOUNDRY_|token|AWS"),
        ("models: {tasks: {depth: {command: rm}}}", "command|list"),
    ],
)
def test_a_wrong_configuration_is_a_finding_with_its_place(tmp_path: Path, text: str, said: str) -> None:
    write(tmp_path, text)
    with pytest.raises(SpecError, match=said) as error:
        load_setup(tmp_path, {})
    assert all(d.line for d in error.value.diagnostics)


def test_folders_of_recordings_lie_in_the_project(tmp_path: Path) -> None:
    for key in ("recorded: ../elsewhere", "url: 'http://x', record: /tmp/elsewhere"):
        write(tmp_path, f"models: {{tasks: {{depth: {{{key}}}}}}}")
        with pytest.raises(ModelError, match="lies outside of the project"):
            load_setup(tmp_path, {}).client("depth")


def test_nothing_is_configured() -> None:
    empty = ModelSetup(Path())
    assert {row.status for row in inventory(empty)} == {"offline", "none"}
    for task in TASKS:
        if task in OFFLINE:
            assert open_model(empty, task) is not None  # type: ignore[call-overload]
        else:
            with pytest.raises(ModelError, match=f"`{task}` needs a model: set SIMFOUNDRY_MODEL_{task.upper()} to"):
                open_model(empty, task)  # type: ignore[call-overload]


def test_what_answers_is_listed_and_what_may_not_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(write(tmp_path, ""))
    research = Model({**IDENTITY, "name": "FoundationStereo", "commercial": True}, {"stereo": truth.stereo})
    with serving(truth.TRUTH) as url, serving(research) as other:
        monkeypatch.setenv("SIMFOUNDRY_MODEL_DEPTH", url)
        monkeypatch.setenv("SIMFOUNDRY_MODEL_SEGMENT", url)
        monkeypatch.setenv("SIMFOUNDRY_MODEL_STEREO", other)
        monkeypatch.setenv("SIMFOUNDRY_MODEL_MESH", "http://127.0.0.1:9")
        code, rows = _models()
        assert code == 0 and rows["depth"]["status"] == "configured" and rows["depth"]["model"] is None
        code, rows = _models("--check")
        assert code == 1 and rows["mesh"]["status"] == "fails" and "did not respond" in rows["mesh"]["problem"]
        assert rows["depth"]["model"] == IDENTITY and rows["stereo"]["status"] == "answers"
        assert rows["stereo"]["commercial"] == "forbidden"
        code, rows = _models("--commercial-only")
        assert code == 1 and rows["stereo"]["status"] == "refused" and rows["depth"]["status"] == "answers"
        setup = load_setup(commercial_only=True)
        with pytest.raises(ModelError, match=r"FoundationStereo may not be used commercially.*127\.0\.0\.1"):
            CALLS["stereo"](setup.client("stereo"))
        assert CALLS["depth"](setup.client("depth")).made_by.name == "truth"
        monkeypatch.setenv("SIMFOUNDRY_MODEL_STEREO", url.replace("127.0.0.1", "localhost"))
        found = open_model(load_setup(), "segment").segment(FRAMES[0], SegmentationPrompt(phrases=("box",)))
        assert found.made_by.name == "truth" and isinstance(open_model(load_setup(), "segment"), BundleMasks)
    assert any("FoundationStereo 1.0, Apache-2.0, commercial use: forbidden" in line for line in _lines(rows))


def _models(*options: str) -> tuple[int, dict[str, Any]]:
    ran = CliRunner().invoke(app, ["models", *options, "--json"], standalone_mode=False)
    return int(ran.return_value), {row["task"]: row for row in json.loads(ran.stdout)["models"]}


def _lines(rows: dict[str, Any]) -> list[str]:
    from simfoundry.models.inventory import TaskModel

    kinds = {"answers", "refused"}
    built = [
        TaskModel(r["task"], r["role"], r["summary"], r["status"], r["place"], r["configured_in"],
                  ModelIdentity(**r["model"]), (r["commercial"], r["reason"]), r["problem"])
        for r in rows.values() if r["status"] in kinds
    ]  # fmt: skip
    return lines(built)


def test_the_table_of_licences_is_shown() -> None:
    ran = CliRunner().invoke(app, ["models", "--licences", "--json"], standalone_mode=False)
    assert {row["name"] for row in json.loads(ran.stdout)["licences"]} == set(licences())
    text = CliRunner().invoke(app, ["models", "--licences"], standalone_mode=False).output
    assert "foundationpose " in text and "NVIDIA source code licence permits research only" in text


@pytest.mark.parametrize("name", ["\x1b[2J\x1b[31mowned", "a\nb", "x" * 300, ""])
def test_a_server_cannot_write_to_the_terminal_by_its_name(name: str) -> None:
    model = Model({**IDENTITY, "name": name}, {"depth": truth.depth})
    with serving(model) as url:
        setup = load_setup(environment={"SIMFOUNDRY_MODEL_DEPTH": url})
        (row,) = (row for row in inventory(setup, check=True) if row.task == "depth")
        assert row.status == "fails" and row.problem.isprintable()
