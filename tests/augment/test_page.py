"""The page augmentation.md: its Python runs."""

from __future__ import annotations

import re

import pytest

from tests.conftest import REPOSITORY


@pytest.mark.slow  # 3 s
@pytest.mark.usefixtures("here")
def test_the_python_of_the_page_runs(capsys: pytest.CaptureFixture[str]) -> None:
    page = (REPOSITORY / "docs/augmentation.md").read_text()
    (block,) = re.findall(r"^```python\n(.*?)^```$", page, re.M | re.S)
    exec(compile(block.replace('out="more"', 'out="page"'), "augmentation.md", "exec"), {})
    assert len(capsys.readouterr().out.splitlines()) == 2
