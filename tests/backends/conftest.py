"""What the tests of every backend need: running a shipped loader, and building in another process."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from simfoundry.backends import compile_scene
from simfoundry.backends.usd import compile_usd
from simfoundry.scene.model import Scene
from tests.backends.usd_stages import SCENES, open_stage

if TYPE_CHECKING:
    from pxr import Usd

ROOT = Path(__file__).parents[2]
DIGEST = """
import sys
from simfoundry.backends import compile_scene
from tests.scenes import full_scene
sys.stdout.write(compile_scene(full_scene(), sys.argv[1]).manifest.decode())
"""


@pytest.fixture
def run_loader(tmp_path: Path) -> Callable[[Scene, str], str]:
    """Compile, move the folder, run ``python load.py`` elsewhere without a display; returns what it printed."""

    def run(scene: Scene, target: str) -> str:
        compile_scene(scene, target).write(tmp_path / "built")
        shutil.copytree(tmp_path / "built", tmp_path / "moved here")
        shutil.rmtree(tmp_path / "built")
        bare = {key: value for key, value in os.environ.items() if key not in ("DISPLAY", "WAYLAND_DISPLAY")}
        command = [sys.executable, str(tmp_path / "moved here" / "load.py")]
        done = subprocess.run(command, cwd=tmp_path, env=bare, capture_output=True, text=True, timeout=60, check=False)
        assert done.returncode == 0, done.stderr
        return done.stdout

    return run


@pytest.fixture
def manifest_elsewhere() -> Callable[[str], str]:
    """The manifest of the full scene, built in another process with another hash seed."""

    def run(target: str) -> str:
        environment = os.environ | {"PYTHONHASHSEED": "4321", "PYTHONPATH": str(ROOT)}
        command = [sys.executable, "-c", DIGEST, target]
        return subprocess.run(
            command, env=environment, cwd=ROOT, capture_output=True, text=True, timeout=60, check=True
        ).stdout

    return run


@pytest.fixture(scope="session")
def folders(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Each scene compiled and written once."""
    base = tmp_path_factory.mktemp("usd")
    for name, scene in SCENES.items():
        compile_usd(scene).write(base / name)
    return {name: base / name for name in SCENES}


@pytest.fixture(params=sorted(SCENES))
def compiled(request: pytest.FixtureRequest, folders: dict[str, Path]) -> tuple[Scene, Usd.Stage]:
    name: str = request.param
    return SCENES[name], open_stage(folders[name])


@pytest.fixture
def full(folders: dict[str, Path]) -> tuple[Scene, Usd.Stage]:
    return SCENES["full"], open_stage(folders["full"])


@pytest.fixture
def mechanical(folders: dict[str, Path]) -> tuple[Scene, Usd.Stage]:
    return SCENES["mechanisms"], open_stage(folders["mechanisms"])
