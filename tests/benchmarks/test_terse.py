"""The files of `tests.benchmarks.terse` are valid, mean the same, and ours are the shortest."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
import pytest

from simfoundry.geometry.frames import Array
from simfoundry.lint.lints import lint
from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.lower import lower
from simfoundry.scene.model import SceneObject
from simfoundry.spec.load import load
from tests.benchmarks.terse.counts import FOLDER, FORMATS, SCENES, count, fewest, files, formatted

# The document and the MJCF file that describe the whole scene.
WHOLE = {scene: "cell" if scene == "workstations" else scene for scene in SCENES}


@dataclass(frozen=True)
class Body:
    """What a body is: its mass [kg] and position [m]."""

    mass: float
    p: Array

    def is_like(self, other: Body) -> bool:
        """Whether two bodies are the same within 1 % of the mass and 1 mm."""
        return bool(abs(self.mass - other.mass) <= 0.01 * other.mass and np.allclose(self.p, other.p, atol=1e-3))


@pytest.mark.parametrize("path", [p for s in SCENES for p in files(s, "ours")], ids=lambda p: p.name)
def test_ours_are_checked_without_findings(path: Path) -> None:
    loaded = load(path)
    assert [*loaded.all_findings(), *lint(loaded)] == []


@pytest.mark.parametrize("scene", SCENES)
def test_files_are_in_the_form_in_which_they_are_counted(scene: str) -> None:
    for form in FORMATS:
        assert files(scene, form)
        for path in files(scene, form):
            assert path.read_text() == formatted(path), path.name


@pytest.mark.parametrize("scene", SCENES)
def test_mjcf_means_the_same(scene: str) -> None:
    objects = lower(load(FOLDER / scene / f"{WHOLE[scene]}.scene.yaml")).objects
    model = mujoco.MjModel.from_xml_path(str(FOLDER / scene / f"{WHOLE[scene]}.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    theirs = [Body(model.body(k).mass[0], data.xipos[k]) for k in range(1, model.nbody) if model.body(k).mass[0] > 0]
    ours = [body for item in objects for body in _bodies(item)]
    assert len(theirs) == len(ours)
    for body in ours:
        match = next((other for other in theirs if body.is_like(other)), None)
        assert match is not None, body
        theirs.remove(match)
    fixed = [item for item in objects if item.fixed and not item.joints]
    static = [k for k in range(model.ngeom) if model.geom_bodyid[k] == 0]
    assert len(static) == len(fixed)
    for item in fixed:
        assert any(np.allclose(data.geom_xpos[k], item.X_WO.p, atol=1e-3) for k in static), item.name
    assert model.njnt == sum(not item.fixed for item in objects) + sum(len(item.joints) for item in objects)


def _bodies(item: SceneObject) -> list[Body]:
    """The bodies of an object that have a mass in MJCF; primitives that are fixed are geoms of the world there."""
    if item.fixed and not item.joints:
        return []
    X_OL = link_poses(item)
    return [Body(link.mass, item.X_WO.apply(X_OL[link.name].apply(link.com))) for link in item.links]


def test_ours_is_the_shortest_in_four_of_five_scenes() -> None:
    counts = {scene: {form: count(scene, form) for form in FORMATS} for scene in SCENES}
    assert sum(map(fewest, counts.values())) >= 4, counts
