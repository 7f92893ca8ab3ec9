"""The task of the streams, and the streams themselves."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from simfoundry.data import attempt as attempts
from simfoundry.teleop import run as runs
from tests.teleop import streams


@pytest.fixture(scope="session")
def touch(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The document of a task in which the hand has to touch a block that is 20 cm ahead."""
    return streams.write_bench(tmp_path_factory.mktemp("teleop"))


@pytest.fixture(scope="module", autouse=True)
def open_processes() -> Iterator[None]:
    """Keep the task and the process that replays open between sessions, because starting them takes seconds."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(runs, "close", lambda: None)
        yield
    attempts.close()
