"""Demonstrations of a small arm that pushes a block, which take a second to record and seconds to learn."""

from __future__ import annotations

from pathlib import Path

import pytest

from simfoundry.runtime.extras import EXTRAS
from tests.data.conftest import recorded, write_push


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    missing = EXTRAS["train"].missing
    if missing:
        reason = pytest.mark.skip(reason=f"{', '.join(missing)} not installed; pip install -e '.[train]'")
        for item in items:
            if Path(__file__).parent in item.path.parents and "needs_nothing" not in item.keywords:
                item.add_marker(reason)


@pytest.fixture(scope="session")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The task document."""
    return write_push(tmp_path_factory.mktemp("train"))


@pytest.fixture(scope="session")
def demos(bench: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twelve demonstrations of a policy that pushes the block out."""
    out = tmp_path_factory.mktemp("demos") / "demos"
    recorded(bench, "python:pushing.py:Push", out, 12)
    return out
