"""Parts that are only seen, or only touch; links that are weighed already, and links without parts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from simfoundry.geometry.shapes import Box, Mesh, Sphere
from simfoundry.scene.lower import lower_file
from simfoundry.scene.model import Link
from simfoundry.spec.diagnostics import SpecError

SHEET = "v 0 0 0\nv 0.1 0 0\nv 0 0.2 0\nv 0.1 0.2 0.05\nf 1 2 3\nf 2 4 3\n"
SCENE = "simfoundry: scene/1\nname: s\nobjects: {thing: {asset: thing.asset.yaml}}\n"
WEIGHED = "    mass: 0.3\n    inertial: {com: [0.01, 0.02, 0.03], inertia: [2e-4, 3e-4, 4e-4, 1e-5, 2e-5, 3e-5]}\n"


def _links(folder: Path, body: str) -> tuple[Link, ...]:
    (folder / "simfoundry.yaml").write_text("")
    (folder / "sheet.obj").write_text(SHEET)
    (folder / "s.scene.yaml").write_text(SCENE)
    (folder / "thing.asset.yaml").write_text("simfoundry: asset/1\nname: thing\nlinks:\n  base:\n" + body)
    return lower_file(folder / "s.scene.yaml").object("thing").links


def test_a_visual_part_neither_touches_nor_weighs(tmp_path: Path) -> None:
    body = """    density: 1000
    parts:
      seen: {shape: {sphere: 0.5}, use: visual}
      felt: {shape: {box: [0.1, 0.1, 0.1]}, use: collision, pose: {xyz: [0.2, 0, 0]}}
"""
    (link,) = _links(tmp_path, body)
    assert [v.name for v in link.visuals] == ["seen"] and isinstance(link.visuals[0].geometry, Sphere)
    assert [c.name for c in link.colliders] == ["felt"] and isinstance(link.colliders[0].geometry, Box)
    assert link.mass == pytest.approx(1.0)
    assert link.com == pytest.approx([0.2, 0, 0])


def test_a_visual_mesh_may_be_open_and_keeps_its_pose(tmp_path: Path) -> None:
    body = """    mass: 0.3
    parts:
      seen: {mesh: sheet.obj, scale: 2, use: visual, pose: {xyz: [0, 0, 0.7]}}
      felt: {shape: {sphere: 0.1}, use: collision}
"""
    (link,) = _links(tmp_path, body)
    assert isinstance(link.visuals[0].geometry, Mesh)
    assert np.ptp(link.visuals[0].geometry.vertices, axis=0) == pytest.approx([0.2, 0.4, 0.1])
    assert link.visuals[0].X_LG.p == pytest.approx([0, 0, 0.7])
    assert link.mass == 0.3 and link.com == pytest.approx([0, 0, 0])


def test_what_is_weighed_needs_no_closed_mesh_and_no_parts(tmp_path: Path) -> None:
    (link,) = _links(tmp_path, f"{WEIGHED}    collision: hull\n    parts: {{felt: {{mesh: sheet.obj}}}}\n")
    assert link.mass == 0.3
    assert link.com == pytest.approx([0.01, 0.02, 0.03])
    assert link.inertia == pytest.approx(np.array([[20, 1, 2], [1, 30, 3], [2, 3, 40]]) * 1e-5)
    assert [c.name for c in link.colliders] == ["felt_0"]
    (bare,) = _links(tmp_path, WEIGHED)
    assert bare.mass == 0.3 and not bare.visuals and not bare.colliders
    assert bare.inertia == pytest.approx(link.inertia)


def test_a_center_of_mass_alone_keeps_the_inertia_of_the_parts(tmp_path: Path) -> None:
    body = "    mass: 0.6\n    inertial: {com: [0.01, 0, 0]}\n    parts: {felt: {shape: {box: [0.1, 0.2, 0.3]}}}\n"
    (link,) = _links(tmp_path, body)
    assert link.com == pytest.approx([0.01, 0, 0])
    assert np.diag(link.inertia) == pytest.approx(0.05 * np.array([0.13, 0.10, 0.05]))


@pytest.mark.parametrize("body", ["    mass: 1\n", "    mass: 1\n    parts: {p: {shape: {sphere: 1}, use: visual}}\n"])
def test_a_link_that_touches_nothing_must_say_its_inertia(tmp_path: Path, body: str) -> None:
    with pytest.raises(SpecError, match=r"without collision parts needs `mass` and `inertial\.inertia`"):
        _links(tmp_path, body)
