"""The server that editors run, installed on first use, and a folder that it has open."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from simfoundry.spec.editor.schema import schemas
from tests.conftest import REPOSITORY
from tests.editor.client import Server, started

HERE = Path(__file__).parent
MODULES = HERE / "node_modules"
PACKAGE = "yaml-language-server"
NO_NETWORK = re.compile(r"ENOTFOUND|EAI_AGAIN|ECONNREFUSED|ECONNRESET|ETIMEDOUT|ENETUNREACH|network|offline", re.I)


@pytest.fixture(scope="session")
def command() -> list[str]:
    """How the server is started; the tests are skipped where it cannot be had."""
    if not shutil.which("node") or not shutil.which("npm"):
        pytest.skip("the language server needs node and npm, and they are not installed")
    wanted = json.loads((HERE / "package.json").read_text())["dependencies"][PACKAGE]
    if _version() != wanted:
        _install()
        assert _version() == wanted
    return ["node", str(MODULES / PACKAGE / "bin" / PACKAGE), "--stdio"]


def _version() -> str:
    manifest = MODULES / PACKAGE / "package.json"
    return str(json.loads(manifest.read_text())["version"]) if manifest.is_file() else ""


def _install() -> None:
    """Install what package-lock.json says, aside and then in one step: several workers may be at it."""
    aside = REPOSITORY / "build" / f"editor-{os.getpid()}"
    aside.mkdir(parents=True, exist_ok=True)
    try:
        for name in ("package.json", "package-lock.json"):
            shutil.copy(HERE / name, aside / name)
        call = ["npm", "ci", "--ignore-scripts", "--no-audit", "--no-fund"]
        done = subprocess.run(call, cwd=aside, capture_output=True, text=True, timeout=300, check=False)
        if done.returncode:
            if NO_NETWORK.search(done.stderr):
                pytest.skip("npm cannot install the language server: there is no network")
            pytest.fail(f"npm cannot install the language server:\n{done.stderr}")
        shutil.rmtree(MODULES, ignore_errors=True)
        try:
            (aside / "node_modules").rename(MODULES)
        except OSError:  # another worker was faster
            assert MODULES.is_dir()
    finally:
        shutil.rmtree(aside, ignore_errors=True)


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
