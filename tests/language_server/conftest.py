"""A running language server, and a project that it has open."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.editor.client import Server, started

COMMAND = [sys.executable, "-m", "simfoundry", "lsp", "--stdio"]

DESK = """\
simfoundry: scene/1
name: desk
materials:
  oak: {density: 700, friction: 0.5}
objects:
  desk: {shape: {box: [1, 1, 0.1]}, material: oak, fixed: true, pose: {xyz: [0, 0, -0.05]}}
  mug: {shape: {cylinder: {radius: 0.04, height: 0.1}}, mass: 0.3, place: {on: desk}}
"""


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """A running server, which the tests of a module share."""
    with started(COMMAND, tmp_path_factory.mktemp("open").resolve()) as running:
        yield running


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """An empty project."""
    folder = tmp_path.resolve()
    (folder / "simfoundry.yaml").touch()
    return folder
