"""Height fields: flat objects that are no primitives get the outline and the heights that are seen of them."""

from __future__ import annotations

import numpy as np
import pytest

from simfoundry.assets import mass
from simfoundry.assets.deviation import surface_samples
from simfoundry.assets.mesh import open_edges, weld
from simfoundry.capture.accuracy.scene_accuracy import surface_distance
from simfoundry.capture.shapes.evidence import FitCandidate
from simfoundry.capture.shapes.fit import MOST_FACES, SAME_VOLUME, candidates, choose, lighter_mesh
from simfoundry.capture.shapes.fit_relief import fit_mirrored_relief, fit_relief
from simfoundry.geometry.frames import Pose, quat_from_rpy
from simfoundry.geometry.shapes import Box, Cylinder, Mesh, closed_mesh, tessellate
from tests.capture.test_register_mesh import evidence_of


def joined(*parts: tuple[Box | Cylinder, Pose]) -> Mesh:
    """A mesh of several solids that may overlap."""
    vertices, faces, count = [], [], 0
    for geometry, pose in parts:
        mesh = tessellate(geometry)
        vertices.append(pose.apply(mesh.vertices))
        faces.append(mesh.faces + count)
        count += len(mesh.vertices)
    return closed_mesh(np.concatenate(vertices), np.concatenate(faces))


def fork() -> Mesh:
    """A flat Y of three bars, 12 mm high."""
    arm = Box(np.array([0.09, 0.018, 0.012]))
    handle = Box(np.array([0.1, 0.02, 0.012]))
    bars = [(handle, (0.05, 0.0), 0.0), (arm, (-0.03, 0.025), -0.6), (arm, (-0.03, -0.025), 0.6)]
    return joined(*((box, Pose.of((*p, 0.006), quat_from_rpy(0, 0, turn))) for box, p, turn in bars))


def club() -> Mesh:
    """A lying bottle: a thick and a thin cylinder on one axis, 6 cm above the table at most."""
    along = quat_from_rpy(0, np.pi / 2, 0)
    thick, thin = Cylinder(0.03, 0.1), Cylinder(0.014, 0.08)
    return joined((thick, Pose.of((0, 0, 0.03), along)), (thin, Pose.of((0.085, 0, 0.03), along)))


def f1(found: FitCandidate, truth: Mesh, X_WO: Pose) -> float:
    """F1 at 1 cm of a candidate."""
    mesh = tessellate(found.geometry)
    a = found.X_WO.apply(surface_samples(mesh.vertices, mesh.faces, 4000)[0])
    b = X_WO.apply(surface_samples(truth.vertices, truth.faces, 4000)[0])
    return surface_distance(a, b)[1]


def test_a_flat_tool() -> None:
    X_WO = Pose.of((0.01, 0.02, 0.0), quat_from_rpy(0, 0, 0.5))
    evidence = evidence_of(fork(), X_WO, 2)
    found = fit_relief(evidence)
    assert found is not None and f1(found, fork(), X_WO) > 0.98
    assert found.agreement.explained > 0.95 and found.agreement.intrusion < 0.1
    assert isinstance(found.geometry, Mesh)
    vertices, faces = weld(found.geometry.vertices, found.geometry.faces)
    assert not open_edges(faces)
    true = 0.012 * (0.1 * 0.02 + 2 * 0.09 * 0.018)  # the bars overlap by little
    assert mass.mesh(vertices, faces).volume == pytest.approx(true, rel=0.2)
    assert found.geometry.vertices[:, 2].min() == 0.0


def test_a_lying_bottle_is_round_below_too() -> None:
    X_WO = Pose.of((0.0, 0.01, 0.0), quat_from_rpy(0, 0, 1.1))
    evidence = evidence_of(club(), X_WO, 2)
    level, mirrored = fit_relief(evidence), fit_mirrored_relief(evidence)
    assert level is not None and mirrored is not None
    assert f1(mirrored, club(), X_WO) > 0.93 > f1(level, club(), X_WO)
    assert mirrored.cost < level.cost


@pytest.mark.slow
def test_the_best_candidate_of_a_tool_is_a_height_field() -> None:
    X_WO = Pose.of((0.01, 0.02, 0.0), quat_from_rpy(0, 0, 0.5))
    best = choose(candidates(evidence_of(fork(), X_WO, 2)))
    assert best.family in ("relief", "mirrored") and f1(best, fork(), X_WO) > 0.97
    box = joined((Box(np.array([0.1, 0.06, 0.04])), Pose.of((0, 0, 0.02))))
    assert choose(candidates(evidence_of(box, X_WO, 2))).family == "box"


def test_a_height_field_with_fewer_triangles_has_the_same_surface() -> None:
    found = fit_relief(evidence_of(fork(), Pose.of((0.01, 0.02, 0.0), quat_from_rpy(0, 0, 0.5)), 2))
    assert found is not None and isinstance(found.geometry, Mesh)
    full, light = found.geometry, lighter_mesh(found.geometry)
    assert len(full.faces) > 1.5 * MOST_FACES > len(light.faces)
    assert not open_edges(weld(light.vertices, light.faces)[1])
    volumes = [mass.mesh(mesh.vertices, mesh.faces).volume for mesh in (full, light)]
    assert volumes[1] == pytest.approx(volumes[0], rel=SAME_VOLUME)
    assert light.vertices[:, 2].min() == full.vertices[:, 2].min() == 0.0
    chamfer, score = surface_distance(*(surface_samples(m.vertices, m.faces, 8000)[0] for m in (full, light)))
    assert chamfer < 0.001 and score == 1.0
    box = tessellate(Box(np.array([0.1, 0.1, 0.1])))
    assert lighter_mesh(box) is box
