"""The Python of ``docs/datasets.md``."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

from simfoundry.render.gl import Engine, choose_engine
from tests.conftest import REPOSITORY

BLOCKS = re.findall(
    r"^```python\n(.*?)^```", (REPOSITORY / "docs" / "datasets.md").read_text(), re.DOTALL | re.MULTILINE
)


@pytest.mark.slow  # 4 s: it records and builds
@pytest.mark.usefixtures("plain")
@pytest.mark.skipif(choose_engine() is Engine.RAYCAST, reason="no GL driver")
def test_the_python_of_the_page_runs(
    demos: Path, bench: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    here = bench.parent / "page"
    here.mkdir()
    for file in bench.parent.iterdir():
        if file.is_file():
            shutil.copy(file, here)
    shutil.copytree(demos, here / "demos")
    index = here / "demos" / "demonstrations.json"
    index.write_text(re.sub(r'"document": "[^"]*"', '"document": "../push.task.yaml"', index.read_text()))
    monkeypatch.chdir(here)
    converted, built = BLOCKS
    exec(compile(converted, "docs/datasets.md", "exec"), {})
    assert "targets move gradually" in capsys.readouterr().out
    made: dict[str, object] = {}
    exec(compile(built.replace("lerobot-v3", "plain"), "docs/datasets.md", "exec"), made)
    assert made["front"].shape == (240, 320, 3)  # type: ignore[attr-defined]
