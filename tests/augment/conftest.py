"""Demonstrations of the expert with the arm of the package, which take a second to record."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from simfoundry.api.demonstrations import record_plan
from simfoundry.data import attempt as attempts
from simfoundry.data.record import record
from simfoundry.runtime.extras import EXTRAS
from tests.corpora.record import SCENE, TASK


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    missing = EXTRAS["expert"].missing
    if missing:
        reason = pytest.mark.skip(reason=f"{', '.join(missing)} not installed; pip install -e '.[expert]'")
        for item in items:
            if Path(__file__).parent in item.path.parents:
                item.add_marker(reason)


@pytest.fixture(scope="session")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the task, and with two demonstrations of it in ``demos``."""
    folder = tmp_path_factory.mktemp("cell")
    (folder / "cell.scene.yaml").write_text(SCENE)
    (folder / "stack.task.yaml").write_text(TASK)
    try:
        assert record(record_plan([folder / "stack.task.yaml"], "expert", folder / "demos", 2)).kept == 2
    finally:
        attempts.close()
    return folder


@pytest.fixture
def here(cell: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    monkeypatch.chdir(cell)
    yield cell
    attempts.close()
