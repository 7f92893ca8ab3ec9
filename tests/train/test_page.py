"""The page training.md: its Python runs."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

from tests.conftest import REPOSITORY


def test_the_python_of_the_page_runs(bench: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.copytree(bench.parent, tmp_path / "project")
    monkeypatch.chdir(tmp_path / "project")
    page = (REPOSITORY / "docs/training.md").read_text()
    (block,) = re.findall(r"^```python\n(.*?)^```$", page, re.M | re.S)
    # The expert cannot move an arm without a gripper.
    scope: dict[str, object] = {}
    shortened = block.replace("count=12, steps=400", 'policy="python:pushing.py:Push", count=12, steps=30')
    exec(compile(shortened, "training.md", "exec"), scope)
    rates = scope["trained"].rates  # type: ignore[attr-defined]
    assert list(rates) == ["seed_0"] and rates["seed_0"].of == 4
