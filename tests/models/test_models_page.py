"""docs/models.md: its configuration is read, its Python runs against a server, and its tables are those of the code."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from simfoundry.models.contract import Member
from simfoundry.models.onnx.adapters import NETWORKS
from simfoundry.models.open import OFFLINE
from simfoundry.models.setup import load_setup
from simfoundry.models.tasks.registry import TASKS
from simfoundry.models.transports.http import HttpTransport
from simfoundry.models.transports.process import ProcessTransport
from simfoundry.models.wire import ANSWER, REQUEST, Bundle, read_bundle, write_bundle
from tests.conftest import REPOSITORY
from tests.models import SERVERS, truth
from tests.models.test_tasks import FRAMES, serving

PAGE = (REPOSITORY / "docs" / "models.md").read_text()


def blocks(language: str) -> list[str]:
    """Return the blocks of the page that this module runs."""
    return re.findall(rf"^<!-- run in: [^\n]* -->\n```{language}\n(.*?)^```$", PAGE, re.M | re.S)


def member(one: Member) -> str:
    """Describe a member in a table."""
    what = {"array": one.dtype, "image": "RGB", "rgba": "RGBA", "images": "RGB images"}.get(one.kind, one.kind)
    shape = f" ({', '.join(map(str, one.shape))})" if one.shape else ""
    details = "".join(f", {word}" for word in (one.unit, one.frame) if word)
    return f"`{one.name}`{'?' if one.is_optional else ''} {what}{shape}{details}"


def row(name: str) -> str:
    """Return the row of a task in the table of contracts."""
    task = TASKS[name]
    given, got = (", ".join(map(member, members)) for members in (task.inputs, task.outputs))
    values = f"`values`: {task.values.__name__}" if task.values is not None else ""
    return f"| `{name}` | {given} | {got or values} |"


def test_the_table_of_contracts_is_that_of_the_code() -> None:
    missing = [row(name) for name in TASKS if row(name) not in PAGE]
    assert not missing, "\n".join(missing)
    assert all(f"| `{name}` | {what} |" in PAGE for name, (_, what) in OFFLINE.items())
    assert all(network.file in PAGE for network in NETWORKS.values())
    assert all(f"`{path.name}`" in PAGE for path in SERVERS.glob("serve_*.py"))


def test_the_configuration_is_read(tmp_path: Path) -> None:
    (text,) = blocks("yaml")
    (tmp_path / "simfoundry.yaml").write_text(text)
    setup = load_setup(tmp_path, {"SIMFOUNDRY_GPU_TOKEN": "t", "SIMFOUNDRY_TRUST": str(tmp_path)})
    depth = setup.client("depth")
    assert isinstance(depth.transport, HttpTransport) and depth.transport.token == "t"
    assert depth.record == tmp_path / "build/answers" and setup.accepted == ("hunyuan3d-2.1",)
    assert isinstance(setup.client("mesh").transport, ProcessTransport) and setup.commercial_only
    assert setup.source("inpaint") is not None and setup.source("stereo") is not None


def test_the_python_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "desk.png").write_bytes(truth.png(FRAMES[0]))
    with serving(truth.TRUTH) as url:
        monkeypatch.setenv("SIMFOUNDRY_MODEL_DEPTH", url)
        for text in blocks("python"):
            exec(compile(text, "docs/models.md", "exec"), {})
    assert capsys.readouterr().out.startswith("(48, 64) truth 1.0\n")


def test_the_documents_of_a_bundle_are_read() -> None:
    request, answer = map(json.loads, blocks("json"))
    image, depth = truth.FRAME, truth.view()[1]
    sent = Bundle({k: v for k, v in request.items() if k != "members"}, {"image": image, "K": truth.K})
    assert set(request["members"]) == set(sent.members)
    assert read_bundle(write_bundle(sent, REQUEST), REQUEST).head == sent.head
    got = Bundle({k: v for k, v in answer.items() if k != "members"}, {"depth": depth}, {"depth": {"unit": "m"}})
    assert read_bundle(write_bundle(got, ANSWER), ANSWER).head == got.head
