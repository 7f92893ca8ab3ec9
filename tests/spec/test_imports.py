"""Checking a text starts at once: nothing heavy is loaded for it."""

from __future__ import annotations

import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest

HEAVY = ("numpy", "trimesh", "scipy", "pxr", "mujoco", "pybullet", "cv2", "shapely", "coacd", "PIL", "rich")
LIGHT = ("simfoundry", "simfoundry.spec.load", "simfoundry.spec.editor.schema", "simfoundry.spec.yaml.write")


@pytest.mark.parametrize("module", LIGHT)
def test_the_language_loads_nothing_heavy(module: str) -> None:
    code = f"import sys, {module}; print(*(m for m in {HEAVY!r} if m in sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []


def test_lowering_itself_loads_only_numpy() -> None:
    code = f"import sys, simfoundry.scene.lower; print(*(m for m in {HEAVY!r} if m in sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["numpy"]


def test_a_check_from_the_shell_waits_for_nothing_it_does_not_use(tmp_path: Path) -> None:
    """A scene of primitives needs numpy at most; simulators, meshes and terminals would double the time."""
    path = tmp_path / "desk.scene.yaml"
    path.write_text("simfoundry: scene/1\nname: desk\nobjects:\n  cup: {shape: {sphere: 0.04}, mass: 0.2}\n")
    code = (
        "import sys; from simfoundry.cli.main import app; import importlib\n"
        f"app(['check', {str(path)!r}], standalone_mode=False)\n"
        "idle = ('scipy', 'trimesh', 'mujoco', 'pybullet', 'pxr', 'cv2', 'rich', 'jinja2', 'httpx')\n"
        "print(*(m for m in idle if m in sys.modules))\n"
        "found = importlib.metadata.version('click')\n"  # what waited is there as soon as somebody asks
        "from importlib.metadata import entry_points\n"
        "print(found, len(list(entry_points(group='console_scripts'))) > 0, 'email' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == ["no findings in 1 document", "", f"{version('click')} True True"]
