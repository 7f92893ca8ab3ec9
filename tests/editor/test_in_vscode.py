"""The built extension in VS Code itself, which the package code-server contains, driven in a browser."""

from __future__ import annotations

import json
import os
import shutil
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from editors.npm import NoPackagesError, install
from editors.vscode.build import build, run
from tests.conftest import REPOSITORY

HERE = Path(__file__).parent / "vscode"
DRIVER = HERE / "drive.mjs"

pytestmark = pytest.mark.slow

# Seconds for VS Code to listen on its port.
PATIENCE = 60

SCENE = """\
simfoundry: scene/1
name: desk
objects:
  desk: {shape: {box: [1, 1, 0.1]}, fixed: true, pose: {xyz: [0, 0, -0.05]}}
  cup:
    shape: {box: [0.1, 0.1, 0.1]}
    mass: 0.3
    place: {on: dsk}
relations:
  - OnTop(cup, desk)
"""


@pytest.fixture(scope="module")
def browser() -> str:
    """A browser that runs without a screen."""
    found = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if found is None:
        pytest.skip("Chromium is not installed")
    return found


@pytest.fixture(scope="module")
def vscode() -> Path:
    """The folder of VS Code's server. Its native modules, for logs and terminals, are not built."""
    try:
        server = install(HERE, REPOSITORY / "build") / "code-server" / "lib" / "vscode"
    except NoPackagesError as error:
        pytest.skip(str(error))
    if not (server / "node_modules").is_dir():
        # Not `npm ci`, for which the lock file of the package lacks an optional dependency; its versions are used.
        run(["npm", "install", "--omit=dev", "--ignore-scripts", "--no-audit", "--no-fund"], server)
    return server


@pytest.fixture(scope="module")
def address(vscode: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of a running VS Code that has the extension and a project with a mistake."""
    folder = tmp_path_factory.mktemp("vscode").resolve()
    project = folder / "project"
    program = project / ".venv" / "bin" / "simfoundry"
    program.parent.mkdir(parents=True)
    program.write_text("#!/bin/sh\necho 'Error: the module pygls is missing.' >&2\nexit 1\n")
    mended = program.with_name("mended")  # what the driver puts in its place
    mended.write_text(f'#!/bin/sh\nPYTHONPATH="{REPOSITORY}" exec "{sys.executable}" -m simfoundry "$@"\n')
    for each in (program, mended):
        each.chmod(0o755)
    (project / "simfoundry.yaml").touch()
    (project / "desk.scene.yaml").write_text(SCENE)
    (project / ".vscode").mkdir()
    settings = {"workbench.startupEditor": "none", "editor.minimap.enabled": False, "editor.wordWrap": "off"}
    (project / ".vscode" / "settings.json").write_text(json.dumps(settings))
    places = [f"--{name}={folder / name}" for name in ("extensions-dir", "user-data-dir", "server-data-dir")]
    call = ["node", str(vscode / "out" / "server-main.js"), "--accept-server-license-terms", *places]
    run([*call, f"--install-extension={build(folder)}"], folder)
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    host = ["--host=127.0.0.1", f"--port={port}", "--without-connection-token"]
    with (folder / "log").open("wb") as log:
        process = subprocess.Popen([*call, *host], cwd=folder, stdout=log, stderr=log, env=os.environ)
    try:
        wait_for(f"http://127.0.0.1:{port}/", process, folder / "log")
        yield f"http://127.0.0.1:{port}/?folder={project}"
    finally:
        process.terminate()
        process.wait(PATIENCE)


def wait_for(address: str, process: subprocess.Popen[bytes], log: Path) -> None:
    """Wait until a server answers."""
    for _ in range(10 * PATIENCE):
        try:
            with urllib.request.urlopen(address):
                return
        except urllib.error.URLError:
            assert process.poll() is None, log.read_text()
            time.sleep(0.1)
    pytest.fail(f"VS Code does not answer:\n{log.read_text()}")


@pytest.fixture(scope="module")
def seen(address: str, browser: str, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What a person sees after each step."""
    pictures = tmp_path_factory.mktemp("pictures")
    out = json.loads(run(["node", str(DRIVER), address, browser, str(pictures)], HERE).splitlines()[-1])
    print(f"pictures of each step: {pictures}\n{json.dumps(out, indent=1)}")
    return dict(out)


def test_a_scene_is_of_the_language(seen: dict[str, Any]) -> None:
    assert seen["trust"] == "SimFoundry"


def test_a_server_that_does_not_start_says_why_once(seen: dict[str, Any]) -> None:
    words = "The language server (simfoundry lsp) stopped: Error: the module pygls is missing."
    assert seen["missing"] == [f'{words} If a package is missing, install it with pip install "simfoundry[editor]".']


def test_a_finding_appears_and_goes(seen: dict[str, Any]) -> None:
    assert "1" in seen["finding"] and seen["fixed"] == "No Problems"


def test_names_of_objects_are_completed(seen: dict[str, Any]) -> None:
    assert "desk" in seen["completion"]


def test_an_object_is_renamed_everywhere(seen: dict[str, Any]) -> None:
    assert seen["rename"] == ["  mug:", "  - OnTop(mug, desk)"]


def test_the_scene_is_shown_and_follows_the_text(seen: dict[str, Any]) -> None:
    picture = seen["picture"]
    assert picture["width"] > 100 and picture["height"] > 100 and picture["message"] == ""
    assert seen["keystroke"] is True


def test_the_picture_stays_while_the_text_is_invalid(seen: dict[str, Any]) -> None:
    assert seen["invalid"]["kept"] is True and seen["invalid"]["words"] and seen["invalid"]["gone"] == ""


def test_the_view_follows_the_mouse(seen: dict[str, Any]) -> None:
    assert seen["orbit"] is True and seen["zoom"] is True


def test_a_restarted_server_finds_the_same(seen: dict[str, Any]) -> None:
    assert seen["restart"]["again"] == seen["restart"]["broken"] != "No Problems"
