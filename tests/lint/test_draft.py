"""What a check knows of meshes that it does not cut, and what it says of places that only geometry refutes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from simfoundry.assets.cache import Cache
from simfoundry.assets.solids import prism_mesh
from simfoundry.scene.lower import lower_file
from simfoundry.spec.load import load
from tests.assets.meshes import obj
from tests.lint.scenes import BOWL, codes, draft, findings, written

ELL = "ell: {asset: ell.obj, mass: 0.3, pose: {xyz: [0, 0, 0.025]}}"
BALL = "ball: {shape: {sphere: 0.02}, mass: 0.1, pose: {xyz: [0.06, 0.06, 0.02]}}"
"""Within the hull of the ell, in its corner, and far from either leg."""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with an L-shaped mesh, and an empty cache."""
    monkeypatch.setenv("SIMFOUNDRY_CACHE", str(tmp_path / "cache"))
    outline = np.array([(0, 0), (0.1, 0), (0.1, 0.02), (0.02, 0.02), (0.02, 0.1), (0, 0.1)])
    (tmp_path / "ell.obj").write_text(obj(*prism_mesh(outline, 0.05)))
    return tmp_path


def test_of_an_uncut_mesh_only_what_is_certain_is_said(folder: Path) -> None:
    path = written(folder, f"{ELL}\n{BALL}", "relations: [Touching(ball, ell), OnTop(ell, desk)]\n")
    scene = draft(path)
    assert scene.approximate == {"ell"}
    assert codes(path) == []  # the ball is within the hull: nobody knows whether it touches


def test_a_mesh_far_away_touches_nothing(folder: Path) -> None:
    far = BALL.replace("0.06, 0.06", "0.4, 0.4")
    (finding,) = findings(written(folder, f"{ELL}\n{far}", "relations: [Touching(ball, ell)]\n"))
    assert finding.code == "SF406"


def test_the_parts_of_a_compile_are_taken(folder: Path) -> None:
    path = written(folder, f"{ELL}\n{BALL}", "relations: [Touching(ball, ell)]\n")
    assert codes(path) == []
    lower_file(path, Cache.default())
    assert draft(path).approximate == frozenset()
    assert codes(path) == ["SF406"]


def test_a_check_finds_an_inside_that_only_geometry_refutes(folder: Path) -> None:
    path = written(
        folder,
        f"bowl: {{{BOWL}, mass: 1}}\nbox: {{shape: {{box: [0.2, 0.2, 0.02]}}, mass: 1, place: {{inside: bowl}}}}",
    )
    assert load(path).errors == []
    (finding,) = findings(path)
    assert (finding.code, finding.path) == ("SF210", "objects.box.place")
    assert "does not fit inside `bowl`" in finding.message
