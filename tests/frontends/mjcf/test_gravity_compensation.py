"""Gravity compensation of links, from MJCF and back."""

from __future__ import annotations

import mujoco
import pytest

from simfoundry.backends import compile_scene
from tests.frontends.conftest import Importing

TEXT = """<mujoco><worldbody><body name="a" pos="0 0 1" gravcomp="1"><freejoint/><geom size="0.1"/>
  <body name="b" pos="0.3 0 0" gravcomp="0.25"><joint axis="0 1 0"/><geom size="0.1"/></body></body>
  </worldbody></mujoco>"""


def test_gravity_compensation_comes_back(importing: Importing) -> None:
    report, scene = importing("a.xml", TEXT)
    (item,) = scene.objects
    assert [link.gravity_compensation for link in item.links] == [1.0, 0.25]
    assert not [note for note in report.notes if "gravity" in note.what]
    files = {name.rpartition("/")[2]: data for name, data in compile_scene(scene, "mjcf").files.items()}
    model = mujoco.MjModel.from_xml_string(files["scene.xml"].decode(), files)
    assert model.body_gravcomp[1:].tolist() == pytest.approx([1.0, 0.25])
    text = compile_scene(scene, "usd").files["scene.usda"].decode()
    assert text.count("bool physxRigidBody:disableGravity = 1") == 1 and "double mjc:gravcomp = 0.25" in text
    lost = {target: [loss.feature for loss in compile_scene(scene, target).losses] for target in ("urdf", "pybullet")}
    assert all("gravity_compensation" in features for features in lost.values())
