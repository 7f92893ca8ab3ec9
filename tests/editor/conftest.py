"""The server that editors run, installed on first use, and a folder that it has open."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from editors.npm import NoPackagesError, install
from simfoundry.spec.editor.schema import schemas
from tests.conftest import REPOSITORY
from tests.editor.client import Server, started

HERE = Path(__file__).parent
MODULES = HERE / "node_modules"
PACKAGE = "yaml-language-server"


@pytest.fixture(scope="session")
def command() -> list[str]:
    """How the server is started; the tests are skipped where it cannot be had."""
    try:
        install(HERE, REPOSITORY / "build")
    except NoPackagesError as error:
        pytest.skip(str(error))
    return ["node", str(MODULES / PACKAGE / "bin" / PACKAGE), "--stdio"]


@pytest.fixture(scope="session")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A project with the schemas of this version."""
    folder = tmp_path_factory.mktemp("project").resolve()
    (folder / "schemas").mkdir()
    for name, text in schemas().items():
        (folder / "schemas" / name).write_text(text, encoding="utf-8")
    return folder


@pytest.fixture(scope="session")
def server(command: list[str], project: Path) -> Iterator[Server]:
    """A running server."""
    with started(command, project) as running:
        yield running
