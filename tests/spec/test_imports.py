"""Checking a text starts at once: nothing heavy is loaded for it."""

from __future__ import annotations

import subprocess
import sys

import pytest

HEAVY = ("numpy", "trimesh", "scipy", "pxr", "mujoco", "pybullet", "cv2", "shapely", "coacd", "PIL", "rich")
LIGHT = ("simfoundry", "simfoundry.spec.load", "simfoundry.spec.schema", "simfoundry.spec.write")


@pytest.mark.parametrize("module", LIGHT)
def test_the_language_loads_nothing_heavy(module: str) -> None:
    code = f"import sys, {module}; print(*(m for m in {HEAVY!r} if m in sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []


def test_lowering_itself_loads_only_numpy() -> None:
    code = f"import sys, simfoundry.scene.lower; print(*(m for m in {HEAVY!r} if m in sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["numpy"]
