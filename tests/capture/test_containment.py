"""Relations ``Inside`` of captured scenes, decided by the predicate of that name."""

from __future__ import annotations

from pathlib import Path

import pytest

from simfoundry.capture.settling.containment import with_containers
from simfoundry.scene.lower import lower
from simfoundry.spec.load import load_scene
from simfoundry.spec.models.scene import SceneSpec

SCENE = """
simfoundry: scene/1
name: bin
objects:
  table: {shape: {box: [1.0, 1.0, 0.04]}, fixed: true, pose: {xyz: [0, 0, -0.02]}}
  bin: {shape: {open_box: {size: [0.24, 0.2, 0.08], wall: 0.006}}, mass: 0.3, pose: {xyz: [0.1, 0, 0.04]}}
  can: {shape: {cylinder: {radius: 0.03, height: HEIGHT}}, mass: 0.3, pose: {xyz: [0.1, 0.02, Z]}}
  ball: {shape: {sphere: 0.03}, mass: 0.1, pose: {xyz: [-0.2, 0, 0.03]}}
relations: ["OnTop(bin, table)", "OnTop(can, bin)", "OnTop(ball, table)"]
"""


@pytest.mark.parametrize(("height", "is_inside"), [(0.08, True), (0.2, False)])
def test_what_is_half_in_a_cavity_is_inside(tmp_path: Path, height: float, is_inside: bool) -> None:
    document = tmp_path / "bin.scene.yaml"
    document.write_text(SCENE.replace("HEIGHT", f"{height}").replace("Z", f"{0.006 + height / 2:.4f}"))
    spec = load_scene(document).spec
    assert isinstance(spec, SceneSpec)
    stated = with_containers(spec, lower(load_scene(document))).relations
    inside = ("Inside(can, bin)",) if is_inside else ()
    assert stated == ("OnTop(bin, table)", *inside, "OnTop(can, bin)", "OnTop(ball, table)")
