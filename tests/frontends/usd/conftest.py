"""Compiled stages that tests edit."""

from __future__ import annotations

import pytest

from tests.frontends.usd.stages import Project, project


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Project:
    return project(tmp_path_factory.mktemp("desk"))


@pytest.fixture(scope="module")
def tuesday(tmp_path_factory: pytest.TempPathFactory) -> Project:
    return project(tmp_path_factory.mktemp("tuesday"), "tuesday")
