"""The ray caster against closed formulas and against a ray tracer that tries every triangle."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from simfoundry.geometry.frames import Array, Pose, frozen_array, look_at, quat_from_rpy
from simfoundry.geometry.ray_casts import first_hits, pixel_rays, scattered_rays
from simfoundry.geometry.shapes import Box, Geometry, Mesh, Sphere
from simfoundry.render.raycast import Raycast, quick_image, raycast
from simfoundry.render.shading import encode_srgb
from simfoundry.scene.model import Camera, Light, LightType, Link, Scene, SceneObject, Visual
from simfoundry.scene.state import SceneState
from tests.tabletop import INERTIA, box, front_camera, label_png, one, pose, rgba, tabletop

GRAY = rgba("808080")
WHITE = rgba("ffffff")


def skewed_camera(eye: tuple[float, float, float] = (-0.4, 0.3, 0.5), roll: float = 0.2) -> Camera:
    """Off-center principal point, fx != fy, rolled about its own axis."""
    X_WC = look_at(np.array(eye), np.array([0.03, -0.02, 0.04])) @ Pose.of(q=quat_from_rpy(0, 0, roll))
    return Camera("skewed", 96, 72, 150.0, 120.0, 40.3, 41.9, X_WC)


def rays_of(camera: Camera) -> tuple[Array, Array]:
    """World origin and direction of each pixel, of length one along the optical axis; shapes (3,) and (h, w, 3)."""
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    local = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape)], axis=-1)
    return camera.X_WC.p, local @ camera.X_WC.rotation.T


def box_depth(size: Array, X_WG: Pose, origin: Array, directions: Array) -> Array:
    """Where rays enter a box, by slabs; NaN for a miss."""
    o = X_WG.inverse().apply(origin)
    d = directions @ X_WG.rotation
    with np.errstate(divide="ignore"):
        t = np.stack([(-size / 2 - o) / d, (size / 2 - o) / d])
    enter, leave = t.min(axis=0).max(axis=-1), t.max(axis=0).min(axis=-1)
    return np.asarray(np.where((enter < leave) & (enter > 0), enter, np.nan))


def alone(geometry: Geometry, X_WO: Pose, color: Array = GRAY, lights: tuple[Light, ...] = ()) -> Scene:
    return Scene("alone", frozen_array([0, 0, -9.81]), (one("thing", geometry, color, X_WO),), (), lights)


def test_depth_and_normals_of_a_turned_box_are_those_of_the_formula() -> None:
    shape, X_WG, camera = box(0.2, 0.12, 0.09), pose(0.02, -0.03, 0.05, 0.4, -0.3, 0.8), skewed_camera()
    seen = raycast(alone(shape, X_WG), camera)
    expected = box_depth(shape.size, X_WG, *rays_of(camera))
    assert 500 < np.isfinite(expected).sum() < 5000
    np.testing.assert_array_equal(np.isfinite(seen.depth), np.isfinite(expected))
    np.testing.assert_allclose(seen.depth, expected, atol=1e-12)
    np.testing.assert_array_equal(seen.objects, np.isfinite(expected).astype(np.int32))
    local = seen.normals[seen.objects > 0] @ X_WG.rotation  # a box has only normals along its axes
    np.testing.assert_allclose(np.sort(np.abs(local), axis=1), np.tile([0, 0, 1.0], (len(local), 1)), atol=1e-9)
    _, directions = rays_of(camera)
    assert ((seen.normals * directions).sum(axis=-1)[seen.objects > 0] < 0).all()


def test_a_sphere_is_smooth_and_where_the_formula_puts_it() -> None:
    center, radius, camera = np.array([0.05, 0.02, 0.03]), 0.08, skewed_camera()
    seen = raycast(alone(Sphere(radius), Pose.of(center, quat_from_rpy(0.3, 0.5, 0.1))), camera)
    origin, d = rays_of(camera)
    a, b = (d * d).sum(axis=-1), (d * (origin - center)).sum(axis=-1)
    root = b * b - a * ((origin - center) @ (origin - center) - radius**2)
    inside = root > 0
    expected = (-b[inside] - np.sqrt(root[inside])) / a[inside]
    assert (seen.objects[inside] == 1).mean() > 0.99  # the inscribed mesh is thinner by a few micrometers
    assert not seen.objects[~inside].any()
    error = np.abs(seen.depth[inside] - expected)
    assert np.nanmedian(error) < radius * (1 - np.cos(np.pi / 48))
    normal = (origin + expected[:, None] * d[inside] - center) / radius
    cosine = (normal * seen.normals[inside]).sum(axis=-1)
    assert np.nanpercentile(cosine, 1) > np.cos(np.radians(2.0))


def tried_one_by_one(triangles: Array, directions: Array) -> tuple[NDArray[np.int64], Array]:
    """Nearest triangle of each ray from the origin by Moller and Trumbore's test of every pair."""
    a, ab, ac = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    p = np.cross(directions[:, None], ac)
    det = (ab * p).sum(axis=-1)
    u = (-a * p).sum(axis=-1) / det
    q = np.cross(-a, ab)
    v = (directions[:, None] * q).sum(axis=-1) / det
    t = (ac * q).sum(axis=-1) / det
    t = np.where((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 1e-3), t, np.inf)
    return np.where(np.isfinite(t.min(axis=1)), t.argmin(axis=1), -1), t.min(axis=1)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("arrangement", ["pixels", "scattered"])
def test_first_hits_of_a_random_soup_are_those_of_trying_every_pair(seed: int, arrangement: str) -> None:
    rng = np.random.default_rng(seed)
    middle = rng.normal(size=(300, 1, 3)) * [1.0, 1.0, 1.5] + [0, 0, 1.0]  # many lie behind, many reach behind
    triangles = middle + rng.normal(size=(300, 3, 3)) * rng.choice([0.05, 0.3, 2.0], size=(300, 1, 1))
    if arrangement == "pixels":
        rays = pixel_rays(41, range(37), 45.0, 39.0, 17.2, 20.9)
        x, y = rays.x, rays.y
    else:
        x, y = rng.normal(size=(2, 900))
        rays = scattered_rays(x, y)
    expected, depth = tried_one_by_one(triangles, np.stack([x, y, np.ones_like(x)], axis=1))
    hits = first_hits(triangles, rays)
    np.testing.assert_array_equal(hits.triangle, expected)
    met = expected >= 0
    assert met.sum() > 200
    np.testing.assert_allclose(1 / hits.inverse_depth[met], depth[met], rtol=1e-9)
    rebuilt = (triangles[expected[met]] * hits.weights[met][..., None]).sum(axis=1)
    np.testing.assert_allclose(rebuilt, np.stack([x, y, np.ones_like(x)], axis=1)[met] * depth[met, None], atol=1e-8)


def test_a_floor_keeps_only_what_is_nearer() -> None:
    rng = np.random.default_rng(9)
    triangles = rng.normal(size=(200, 3, 3)) * 0.5 + [0, 0, 2.0]
    x, y = rng.normal(size=(2, 500)) * 0.3
    free = first_hits(triangles, scattered_rays(x, y))
    met = np.flatnonzero(free.triangle >= 0)
    just_before = first_hits(triangles, scattered_rays(x, y), free.inverse_depth * (1 + 1e-9) + 1e-12)
    just_behind = first_hits(triangles, scattered_rays(x, y), free.inverse_depth * (1 - 1e-9))
    assert (just_before.triangle[met] == -1).all()
    np.testing.assert_array_equal(just_behind.triangle[met], free.triangle[met])


def test_no_ray_slips_between_triangles_that_share_an_edge() -> None:
    """Vertices are projected onto pixel centers, where a careless edge rule leaves holes or hits twice."""
    grid = np.stack(np.meshgrid(np.arange(9.0), np.arange(9.0)), axis=-1) * 2
    corners = np.concatenate([grid, np.full((9, 9, 1), 1.0)], axis=-1)
    a, b, c, d = corners[:-1, :-1], corners[:-1, 1:], corners[1:, 1:], corners[1:, :-1]
    triangles = np.concatenate([np.stack([a, b, c], axis=2), np.stack([a, c, d], axis=2)]).reshape(-1, 3, 3)
    hits = first_hits(triangles, pixel_rays(17, range(17), 1.0, 1.0, 0.0, 0.0))
    assert (hits.triangle >= 0).all()
    np.testing.assert_allclose(hits.inverse_depth, 1.0, rtol=1e-12)


def test_the_nearest_object_wins_and_the_state_moves_links_and_objects() -> None:
    scene, camera = tabletop(), replace(front_camera(160, 120))
    shut = raycast(scene, camera)
    assert set(np.unique(shut.objects)) == set(range(len(scene.objects) + 1))
    moved = SceneState.of({"apple": pose(0.40, -0.30, 0.036)}, {"cabinet.drawer": 0.12})
    opened = raycast(scene, camera, moved)
    number = {o.name: k + 1 for k, o in enumerate(scene.objects)}
    cabinet = number["cabinet"]
    assert (opened.objects == cabinet).sum() > 1.2 * (shut.objects == cabinet).sum()
    assert np.nanmin(opened.depth[opened.objects == cabinet]) < np.nanmin(shut.depth[shut.objects == cabinet]) - 0.08
    apple = raycast(scene, camera, moved).objects == number["apple"]
    assert not (apple & (shut.objects == number["apple"])).any()
    v, u = np.argwhere(apple).mean(axis=0)
    p = camera.X_WC.inverse().apply(np.array([0.40, -0.30, 0.036]))
    expected = (camera.fx * p[0] / p[2] + camera.cx, camera.fy * p[1] / p[2] + camera.cy)
    assert (u, v) == pytest.approx(expected, abs=0.5)


def picture_board(png: bytes) -> Mesh:
    """A board in the xz plane that faces -y, u along x, v along z; two triangles, seen from both sides."""
    vertices = [[0, 0, 0], [0.4, 0, 0], [0.4, 0, 0.2], [0, 0, 0.2]]
    faces = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)
    return Mesh(frozen_array(vertices), faces, frozen_array([[0, 0], [1, 0], [1, 1], [0, 1]]), png)


def dome(intensity: float) -> Light:
    return Light("dome", LightType.DOME, intensity, frozen_array([1, 1, 1]), Pose.of())


def test_a_texture_is_upright_not_mirrored_and_true_in_color() -> None:
    X_WC = look_at(np.array([0.2, -1.0, 0.1]), np.array([0.2, 0.0, 0.1]))
    camera = Camera("eye", 256, 128, 640.0, 640.0, 127.5, 63.5, X_WC)  # the board fills the picture exactly
    seen = raycast(alone(picture_board(label_png(256, 128)), Pose.of(), WHITE, (dome(1.0),)), camera)
    assert (seen.objects == 1).all()
    from io import BytesIO

    from PIL import Image

    with Image.open(BytesIO(label_png(256, 128))) as picture:
        texture = np.asarray(picture.convert("RGB")).astype(int)
    assert np.abs(seen.color.astype(int) - texture).max() <= 1
    assert np.abs(seen.color[:, ::-1].astype(int) - texture).mean() > 5  # else a mirrored one would pass


def test_an_open_surface_is_seen_from_behind_with_its_normal_turned() -> None:
    behind = look_at(np.array([0.2, 1.0, 0.1]), np.array([0.2, 0.0, 0.1]))
    seen = raycast(alone(picture_board(label_png()), Pose.of()), Camera("eye", 32, 16, 60, 60, 15.5, 7.5, behind))
    assert (seen.objects > 0).sum() > 100
    np.testing.assert_allclose(seen.normals[seen.objects > 0], np.tile([0, 1.0, 0], ((seen.objects > 0).sum(), 1)))


def test_light_follows_lambert_in_linear_light() -> None:
    incidence = np.radians(60)
    sun = Light(
        "sun", LightType.DISTANT, 0.4, frozen_array([1.0, 0.5, 0.25]), Pose.of(q=quat_from_rpy(incidence, 0.0, 0.0))
    )
    down = look_at(np.array([0.0, 0.0, 1.0]), np.zeros(3))
    camera = Camera("eye", 8, 8, 40.0, 40.0, 3.5, 3.5, down)
    seen = raycast(alone(box(2, 2, 0.1), Pose.of(), WHITE, (dome(0.2), sun)), camera)
    expected = encode_srgb(0.2 + 0.4 * np.array([1.0, 0.5, 0.25]) * np.cos(incidence))
    np.testing.assert_array_equal(seen.color, np.broadcast_to(expected, (8, 8, 3)))
    assert encode_srgb(np.array([0.5])) == 188


@pytest.mark.parametrize("kind", [LightType.DISTANT, LightType.POINT])
def test_a_shadow_falls_exactly_where_the_box_hides_the_light(kind: LightType) -> None:
    block, X_WB = box(0.12, 0.08, 0.1), pose(0.02, 0.01, 0.12, 0.3, 0.2, 0.5)
    at = np.array([-0.5, 0.4, 0.9])
    X_WL = look_at(at, np.zeros(3)) @ Pose.of(q=[0, 1, 0, 0])  # a light shines along -z
    lights = (dome(0.1), Light("key", kind, 0.7, frozen_array([1, 1, 1]), X_WL))
    objects = (one("floor", box(2, 2, 0.1), GRAY, pose(0, 0, -0.05)), one("block", block, GRAY, X_WB))
    scene = Scene("shadow", frozen_array([0, 0, -9.81]), objects, (), lights)
    camera = Camera("eye", 200, 160, 240.0, 260.0, 95.0, 81.0, look_at(np.array([0.3, -0.6, 0.7]), np.zeros(3)))
    seen = raycast(scene, camera)
    origin, directions = rays_of(camera)
    points = origin + directions * seen.depth[..., None]
    floor = seen.objects == 1
    if kind is LightType.POINT:
        reach = box_depth(block.size, X_WB, at, points - at)
        hidden = np.isfinite(reach) & (reach < 1)
    else:
        toward = at / np.linalg.norm(at)
        start = points[floor] + 10 * toward
        hits = [box_depth(block.size, X_WB, p, -toward) for p in start]
        hidden = np.zeros(floor.shape, dtype=bool)
        hidden[floor] = np.isfinite(hits)
    dark = seen.color[..., 0] <= encode_srgb(np.array([0.1 * ((128 / 255 + 0.055) / 1.055) ** 2.4]))[0] + 1
    assert (hidden & floor).sum() > 400
    assert ((dark != hidden) & floor).sum() <= 0.005 * (hidden & floor).sum()


def test_glass_shows_itself_and_what_is_behind_and_nothing_is_nothing() -> None:
    camera = Camera("eye", 16, 16, 40.0, 40.0, 7.5, 7.5, look_at(np.array([0.0, -1.0, 0.0]), np.zeros(3)))
    wall = one("wall", box(2, 0.1, 2), rgba("ff0000"), pose(0, 0.5, 0))

    def with_pane(alpha: float) -> Raycast:
        pane = one("pane", box(2, 0.01, 2), rgba("0000ff", alpha), pose(0, 0, 0))
        return raycast(Scene("glass", frozen_array([0, 0, 0]), (wall, pane), (), (dome(1.0),)), camera)

    assert (with_pane(0.0).objects == 1).all()
    assert (with_pane(0.25).objects == 2).all()
    np.testing.assert_allclose(with_pane(0.25).depth, 0.995)
    middle = with_pane(0.25).color[8, 8]
    np.testing.assert_array_equal(middle, encode_srgb(np.array([0.75, 0.0, 0.25])))
    np.testing.assert_array_equal(with_pane(1.0).color[8, 8], [0, 0, 255])


def test_an_empty_scene_is_sky_without_depth() -> None:
    seen = raycast(Scene("empty", frozen_array([0, 0, -9.81]), ()), skewed_camera())
    assert np.isnan(seen.depth).all() and not seen.objects.any() and np.isnan(seen.normals).all()
    assert seen.color.std() > 0
    assert seen.color.min() > 100


def test_samples_smooth_the_color_and_leave_the_rest_alone() -> None:
    scene, camera = tabletop(), front_camera(160, 120)
    rough, smooth = raycast(scene, camera), raycast(scene, camera, samples=2)
    np.testing.assert_array_equal(rough.depth, smooth.depth)
    np.testing.assert_array_equal(rough.objects, smooth.objects)
    steps = [np.abs(np.diff(r.color.astype(float), axis=1)).max(axis=-1) for r in (rough, smooth)]
    assert np.percentile(steps[1], 99) < np.percentile(steps[0], 99)
    with pytest.raises(ValueError, match="samples must be at least 1"):
        raycast(scene, camera, samples=0)


@pytest.mark.parametrize(
    ("samples", "threads", "rays"), [(1, 2, 10**6), (1, 4, 900), pytest.param(2, 2, 8000, marks=pytest.mark.slow)]
)
def test_a_picture_drawn_in_bands_is_the_picture_drawn_at_once(
    monkeypatch: pytest.MonkeyPatch, samples: int, threads: int, rays: int
) -> None:
    scene, camera = tabletop(), replace(front_camera(64, 48), cy=17.3)
    monkeypatch.setattr("simfoundry.render.raycast.MAX_THREADS", 1)
    whole = raycast(scene, camera, samples=samples)
    monkeypatch.setattr("simfoundry.render.raycast.usable_cores", lambda: threads)
    monkeypatch.setattr("simfoundry.render.raycast.MAX_THREADS", threads)
    monkeypatch.setattr("simfoundry.render.raycast.BAND", rays)
    parts = raycast(scene, camera, samples=samples)
    for name in ("color", "depth", "objects", "normals"):
        np.testing.assert_array_equal(getattr(whole, name), getattr(parts, name))


def test_the_far_part_of_a_table_that_reaches_behind_the_camera_is_seen() -> None:
    camera = Camera(
        "eye", 64, 48, 60.0, 60.0, 31.5, 23.5, look_at(np.array([0.0, 0.0, 0.3]), np.array([1.0, 0.2, 0.2]))
    )
    shape, X_WG = box(4, 4, 0.1), pose(0, 0, -0.05, yaw=0.3)
    seen = raycast(alone(shape, X_WG), camera)
    np.testing.assert_allclose(seen.depth, box_depth(shape.size, X_WG, *rays_of(camera)), atol=1e-9)


def test_a_thin_visual_offset_in_its_link_and_a_turned_object_compose() -> None:
    X_WO, X_LG, shape = (
        pose(0.1, 0.05, 0.02, 0.2, 0.4, -0.7),
        pose(0.03, -0.02, 0.05, -0.5, 0.1, 0.3),
        box(0.1, 0.05, 0.02),
    )
    body = Link("body", 0.1, frozen_array([0, 0, 0]), INERTIA, (Visual("v", shape, GRAY, X_LG),), ())
    scene = Scene("offset", frozen_array([0, 0, 0]), (SceneObject("o", "o", False, X_WO, (body,)),))
    camera = skewed_camera()
    expected = box_depth(Box(shape.size).size, X_WO @ X_LG, *rays_of(camera))
    np.testing.assert_allclose(raycast(scene, camera).depth, expected, atol=1e-12)


@pytest.mark.slow  # 2 s: two processes
def test_two_processes_draw_the_same_bytes() -> None:
    code = (
        "import hashlib; from tests.tabletop import *; from simfoundry.render.raycast import raycast;"
        "r = raycast(tabletop(), front_camera(96, 72), samples=2);"
        "print(hashlib.sha256(r.color.tobytes() + r.depth.tobytes() + r.objects.tobytes()).hexdigest())"
    )
    runs = [
        subprocess.run(
            [sys.executable, "-c", code],
            env={"PYTHONHASHSEED": seed, "PYTHONPATH": ":".join(sys.path)},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for seed in ("1", "2")
    ]
    assert len(runs[0].strip()) == 64
    assert all(a == b for a, b in pairwise(runs))


@pytest.mark.slow  # 4 s
def test_a_quick_image_is_nearly_the_exact_one() -> None:
    scene, camera = tabletop(), front_camera()
    exact, quick = raycast(scene, camera, samples=2).color.astype(float), quick_image(scene, camera).astype(float)
    assert quick.shape == exact.shape
    assert np.abs(quick - exact).mean() < 8  # hard shadows, no dark corners, and blended outlines
    assert (np.abs(quick - exact).max(axis=2) < 40).mean() > 0.93


def test_a_quick_image_stops_when_it_is_told_to() -> None:
    steps = 0

    def checkpoint() -> None:
        nonlocal steps
        steps += 1
        if steps == 3:
            raise InterruptedError

    with pytest.raises(InterruptedError):
        quick_image(tabletop(), front_camera(), checkpoint=checkpoint)
