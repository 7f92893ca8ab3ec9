"""What of ``tests.corpora.validators`` needs nothing more, on one scene that says everything; and that it can fail."""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from simfoundry.backends import compile_scene
from simfoundry.scene.lower import lower_file
from tests.corpora.validators import INSTALL, mujoco_warnings, urdf_errors, usd_errors
from tests.targets.everything import LIGHTS, write_everything

if TYPE_CHECKING:
    from pxr import Sdf

LONGEST = 64
"""Values in an array above which NVIDIA's asset validator wants a crate."""


@pytest.fixture(scope="module")
def build(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("everything")
    scene = lower_file(write_everything(folder, *LIGHTS, "background_mesh"))
    for target in ("usd", "mjcf", "urdf"):
        compile_scene(scene, target).write(folder / target)
    return folder


def test_text_layers_hold_no_long_arrays(build: Path) -> None:
    from pxr import Sdf

    longest = 0

    def visit(path: Sdf.Path) -> None:
        nonlocal longest
        if path.IsPropertyPath():
            value: Any = getattr(layer.GetAttributeAtPath(path), "default", None)
            longest = max(longest, len(value) if type(value).__name__.endswith("Array") else 0)

    texts = list((build / "usd").rglob("*.usda"))
    assert [file.name for file in texts] == ["scene.usda"]
    for file in texts:
        layer = Sdf.Layer.FindOrOpen(str(file))
        layer.Traverse("/", visit)
    assert 0 < longest <= LONGEST
    layer = Sdf.Layer.FindOrOpen(str(build / "usd" / "assets" / "meshes.usdc"))
    layer.Traverse("/", visit)
    assert longest > LONGEST  # so the count would have seen them


def test_usd_and_mujoco_have_nothing_to_say(build: Path) -> None:
    assert usd_errors(build / "usd" / "scene.usda") == []
    assert mujoco_warnings(build / "mjcf" / "scene.xml") == []


def test_a_warning_of_mujoco_is_seen(tmp_path: Path) -> None:
    file = tmp_path / "scene.xml"
    file.write_text(
        '<mujoco><option timestep="0.01"/><worldbody><body><joint type="slide" stiffness="1e9" ref="1"/>'
        '<geom size="0.1"/></body></worldbody><keyframe><key qpos="5"/></keyframe></mujoco>'
    )
    assert re.search("unstable|Nan|BADQ", " ".join(mujoco_warnings(file)), re.IGNORECASE)


def test_check_urdf_has_nothing_to_say(build: Path) -> None:
    tool = shutil.which("check_urdf")
    if tool is None:
        pytest.skip(f"needs check_urdf: {INSTALL['check_urdf']}")
    files = sorted((build / "urdf").glob("*.urdf"))
    assert len(files) >= 8
    assert [error for file in files for error in urdf_errors(tool, file)] == []
