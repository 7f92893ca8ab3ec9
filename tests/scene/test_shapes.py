"""Ellipsoids, cones, open boxes and compounds: mass, bounds, placement, predicates, and what engines hold."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np
import pytest

from simfoundry.assets import mass
from simfoundry.backends import compile_scene
from simfoundry.backends.convex_hulls import REPLACED, hull_losses, hull_of
from simfoundry.geometry.distance import Exact, LinkPair, candidates
from simfoundry.geometry.form import Form
from simfoundry.geometry.frames import IDENTITY, Array, Pose, Poses, frozen_array, quat_from_rpy
from simfoundry.geometry.hulls import hulls_of
from simfoundry.geometry.shapes import Cone, Ellipsoid, Primitive, tessellate
from simfoundry.lint.lints import lint
from simfoundry.scene.bodies import BodyBuilder
from simfoundry.scene.lower import lower_file
from simfoundry.scene.object_shapes import geometry_bounds
from simfoundry.scene.place import CLEARANCE
from simfoundry.spec.load import load_scene
from simfoundry.spec.models.base import BodySpec
from simfoundry.spec.models.scene import Place
from simfoundry.spec.models.shapes import BoxShape, OpenBox, OpenBoxShape
from simfoundry.verify.compare import compare
from simfoundry.verify.engines import find_engine
from simfoundry.verify.process import EngineJob, ask
from simfoundry.verify.run import built
from tests.placing import put
from tests.scenes import box, pose, scene_of, solid

ROUND: list[Primitive] = [Ellipsoid(frozen_array([0.05, 0.03, 0.02])), Cone(0.04, 0.1)]
IDS = ["ellipsoid", "cone"]
SHELF = Path(__file__).with_name("new_shapes.scene.yaml")


def moments(geometry: Primitive) -> mass.SolidMoments:
    if isinstance(geometry, Ellipsoid):
        return mass.ellipsoid(geometry.radii)
    assert isinstance(geometry, Cone)
    return mass.cone(geometry.radius, geometry.height)


@pytest.mark.parametrize("geometry", ROUND, ids=IDS)
def test_the_moments_are_those_of_a_fine_mesh(geometry: Primitive) -> None:
    fine, exact = tessellate(geometry, 400), moments(geometry)
    meshed = mass.mesh(fine.vertices, fine.faces)
    assert exact.volume == pytest.approx(meshed.volume, rel=3e-4)
    assert exact.com == pytest.approx(meshed.com, abs=1e-6)
    assert np.abs(exact.inertia - meshed.inertia).max() < 5e-4 * exact.inertia.max()


@pytest.mark.parametrize("geometry", ROUND, ids=IDS)
def test_bounds_and_hulls_enclose_the_surface(geometry: Primitive) -> None:
    points = tessellate(geometry, 400).vertices
    for angles in ((0.0, 0.0, 0.0), (0.3, -0.8, 2.1), (math.pi / 2, 0.0, 0.4)):
        X = Pose.of([0.1, -0.2, 0.3], quat_from_rpy(*angles))
        low, high = geometry_bounds(geometry, X)
        moved = X.apply(points)
        assert low == pytest.approx(moved.min(axis=0), abs=2e-5)
        assert high == pytest.approx(moved.max(axis=0), abs=2e-5)
        ours = hulls_of([(geometry, X, 0)]).bounds()
        assert np.abs(np.subtract(ours, (low, high))).max() < 1.1e-4


@pytest.mark.parametrize("rpy", [(0.0, 0.0, 0.0), (180.0, 0.0, 10.0), (0.0, 90.0, 30.0), (20.0, -50.0, 0.0)])
@pytest.mark.parametrize("geometry", ROUND, ids=IDS)
def test_a_placed_shape_stands_on_its_lowest_point(geometry: Primitive, rpy: tuple[float, float, float]) -> None:
    under = solid("under", box(1, 1, 0.1), pose(0, 0, 0))
    over = put(solid("over", geometry, pose(0, 0, 0)), Place(on="under", xy=(0.1, 0.1), rpy_deg=rpy), under)
    lowest = float(over.X_WO.apply(tessellate(geometry, 240).vertices)[:, 2].min())
    # Placement uses a polyhedron, which is within 0.05 mm of the cone and within 0.2% of the ellipsoid.
    assert lowest == pytest.approx(0.05 + CLEARANCE, abs=1.1e-4)
    scene = scene_of(over, under)
    with_distances = Exact({(o.name, 0): [(o.root.colliders[0].geometry, IDENTITY)] for o in scene.objects})
    forms = [Form.of([(o.root.colliders[0].geometry, IDENTITY)]) for o in scene.objects]
    poses = [Poses.of(o.X_WO.p[None], o.X_WO.q[None]) for o in scene.objects]
    pair = LinkPair(("over", 0), ("under", 0), forms[0], forms[1], poses[0], poses[1])
    (gap,) = with_distances.distance(pair, candidates(pair, np.array([1.0])), np.array([1.0]))
    assert gap == pytest.approx(CLEARANCE, abs=1.1e-4)


@pytest.mark.parametrize("geometry", ROUND, ids=IDS)
def test_the_hull_is_as_far_away_as_it_says(geometry: Primitive) -> None:
    hull, stated = hull_of(geometry)
    assert len(hull.vertices) <= 64
    a, b, c = (hull.vertices[hull.faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    offsets = np.einsum("ij,ij->i", normals, a)
    surface = tessellate(geometry, 200).vertices
    inside = float((surface @ normals.T - offsets).max())  # beyond some face of the hull
    assert inside <= stated * 1.001
    if isinstance(geometry, Ellipsoid):
        outside = np.linalg.norm(hull.vertices / geometry.radii, axis=1).max() - 1
        assert 0.8 * stated < outside * geometry.radii.max() <= stated * 1.001
        assert hull.vertices[:, 2].min() == pytest.approx(-geometry.radii[2])


def test_an_open_box_weighs_what_is_left_of_the_box() -> None:
    """Five walls that do not overlap: the outer box without the inner one."""

    def link(shape: BoxShape | OpenBoxShape, pose: Pose = IDENTITY) -> Array:
        builder = BodyBuilder("it", BodySpec(density=1000.0), {}, None)
        builder.add_shape("it", shape, pose, None)
        made = builder.link(False, None)
        return np.array([made.mass, *(made.com * made.mass), *(made.inertia + made.mass * around(made.com)).flat])

    def around(p: Array) -> Array:
        return float(p @ p) * np.eye(3) - np.outer(p, p)

    whole = link(OpenBoxShape(open_box=OpenBox(size=(0.3, 0.2, 0.1), wall=0.01)))
    outer, inner = link(BoxShape(box=(0.3, 0.2, 0.1))), link(BoxShape(box=(0.28, 0.18, 0.09)), Pose.of([0, 0, 0.005]))
    assert whole == pytest.approx(outer - inner, rel=1e-12, abs=1e-15)


def test_a_compound_is_one_body_of_named_parts() -> None:
    scene = lower_file(SHELF)
    (link,) = scene.object("hammer").links
    assert [c.name for c in link.colliders] == [v.name for v in link.visuals] == ["handle", "head"]
    assert [c.material for c in link.colliders] == ["oak", "rubber"]
    handle = 700 * (math.pi * 0.012**2 * 0.2 + 4 / 3 * math.pi * 0.012**3)
    assert link.mass == pytest.approx(handle + 1100 * math.pi * 0.02**2 * 0.08)
    colors = {v.name: tuple((v.rgba[:3] * 255).round()) for v in scene.object("table").root.visuals}
    assert colors["leg_1"] == (0x30, 0x30, 0x30) and colors["top"] == (0xC8, 0xA0, 0x70)


def test_what_the_scene_states_holds() -> None:
    """Inside an open box, on a compound, and a cone and an ellipsoid that stand."""
    loaded = load_scene(SHELF)
    assert not loaded.errors
    assert [str(d) for d in lint(loaded)] == []


@pytest.mark.parametrize("name", ["mujoco", "pybullet", "usd"])
def test_engines_hold_the_shapes(name: str, tmp_path: Path) -> None:
    if name == "pybullet":
        pytest.importorskip("pybullet", reason="PyBullet is not installed")
    scene, engine = lower_file(SHELF), find_engine(name)
    subject = built("shapes", scene, [engine], tmp_path)
    (answer,) = ask(Path(sys.executable), engine.readback, [EngineJob(subject.builds[name])], timeout=60)
    assert answer.error == "" and answer.facts is not None
    found = compare(scene, answer.facts, engine, subject.losses[name])
    assert [str(d) for d in found.mismatches] == [] and found.stale == ()
    kinds = {c.kind for link in answer.facts.links.values() for c in link.colliders or ()}
    assert kinds >= {"mujoco": {"ellipsoid", "mesh"}, "usd": {"cone", "mesh"}}.get(name, {"mesh"})


def test_hulls_are_reported_once_per_object() -> None:
    scene = lower_file(SHELF)
    for target, kinds in REPLACED.items():
        paths = [loss.path for loss in hull_losses(scene, kinds)]
        assert paths == [{Ellipsoid: "egg.colliders", Cone: "party_hat.colliders"}[kind] for kind in kinds]
        losses = compile_scene(scene, target).losses
        assert {loss.feature for loss in losses} >= {kind.__name__.lower() for kind in kinds}
