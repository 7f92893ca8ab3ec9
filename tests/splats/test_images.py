"""Images of splats: against a direct evaluation of the formula, and composited with objects by depth."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
import pytest

from simfoundry.geometry.frames import Pose, look_at, rotations
from simfoundry.render.backdrop import splat_backdrop
from simfoundry.render.raycast import quick_image, raycast
from simfoundry.scene.lower import lower_file
from simfoundry.scene.model import Scene
from simfoundry.splats.files import splat_bytes
from simfoundry.splats.gaussians import GaussianSplat, gaussian_splat
from simfoundry.splats.harmonics import SH0, harmonic_basis
from simfoundry.splats.projection import BLUR, project
from simfoundry.splats.raster import composite, splat_image
from simfoundry.worlds import open_world
from tests.splats.random_splats import random_splat


@dataclass(frozen=True)
class Lens:
    """Intrinsics of a camera, with an off-center principal point and unequal focal lengths."""

    width: int = 48
    height: int = 36
    fx: float = 40.0
    fy: float = 44.0
    cx: float = 20.3
    cy: float = 19.1


def view(splat: GaussianSplat) -> Pose:
    """Return the pose of a splat in front of a camera that sees most of it."""
    return look_at(np.array([2.4, -1.6, 1.2]), splat.positions.mean(axis=0).astype(float)).inverse()


def directly(splat: GaussianSplat, X_CF: Pose, lens: Lens, stop: np.ndarray | None = None) -> tuple[np.ndarray, ...]:
    """Return color, opacity and depth by a loop over all Gaussians and pixels, from the equations of the paper."""
    v, u = np.mgrid[: lens.height, : lens.width].astype(float)
    p_C = X_CF.apply(splat.positions.astype(float))
    turns = X_CF.rotation @ rotations(splat.rotations.astype(float))
    eye = X_CF.inverse().p
    alphas, depths, colors = [], [], []
    for k, (x, y, z) in enumerate(p_C):
        if z <= 0.1:
            continue
        half = np.array([lens.width / lens.fx, lens.height / lens.fy]) / 2
        middle = (((lens.width - 1) / 2 - lens.cx) / lens.fx, ((lens.height - 1) / 2 - lens.cy) / lens.fy)
        tx, ty = (np.clip(t, m - 1.3 * h, m + 1.3 * h) for t, m, h in zip((x / z, y / z), middle, half, strict=True))
        J = np.array([[lens.fx / z, 0, -lens.fx * tx / z], [0, lens.fy / z, -lens.fy * ty / z], [0, 0, 1]])
        covariance = J @ turns[k] @ np.diag(splat.scales[k].astype(float) ** 2) @ turns[k].T @ J.T
        blurred = covariance[:2, :2] + BLUR * np.eye(2)
        inverse = np.linalg.inv(blurred)
        opacity = splat.opacities[k] * np.sqrt(max(np.linalg.det(covariance[:2, :2]), 0) / np.linalg.det(blurred))
        d = np.stack([u - (lens.fx * x / z + lens.cx), v - (lens.fy * y / z + lens.cy)], axis=-1)
        alpha = opacity * np.exp(-0.5 * np.einsum("hwi,ij,hwj->hw", d, inverse, d))
        near = z + d @ inverse @ covariance[:2, 2]
        alpha = np.where(alpha < 1 / 255, 0, np.minimum(alpha, 0.9999))
        alphas.append(alpha if stop is None else np.where(near < stop, alpha, 0))
        depths.append(near)
        away = splat.positions[k] - eye
        basis = harmonic_basis(away[None] / np.linalg.norm(away), splat.degree)[0]
        colors.append(np.maximum(basis @ splat.harmonics[k] + 0.5, 0))
    color, light, half_depth = np.zeros((*u.shape, 3)), np.ones_like(u), np.zeros_like(u)
    order = np.argsort(depths, axis=0, kind="stable")
    for ranked in order:
        alpha, near = (np.take_along_axis(np.array(a), ranked[None], 0)[0] for a in (alphas, depths))
        color += (alpha * light)[..., None] * np.array(colors)[ranked]
        passed = light * (1 - alpha)
        half_depth = np.where((light >= 0.5) & (passed < 0.5), near, half_depth)
        light = passed
    return color, 1 - light, half_depth


@pytest.mark.parametrize("degree", [0, 1, 3])
def test_an_image_is_that_of_the_equations(degree: int) -> None:
    splat = random_splat(150, degree, degree + 4, spread=0.5)
    lens, X_CF = Lens(), view(splat)
    image = splat_image(splat, X_CF, lens)
    color, alpha, depth = directly(splat, X_CF, lens)
    assert alpha.max() > 0.4 and (alpha > 0.05).mean() > 0.3  # the view is not empty
    np.testing.assert_allclose(image.color, color, atol=3e-4)  # what is behind a transmittance of 1e-4 is left out
    np.testing.assert_allclose(image.alpha, alpha, atol=3e-4)
    np.testing.assert_allclose(image.depth, depth, atol=1e-9)


def test_what_is_behind_a_surface_is_left_out() -> None:
    splat = random_splat(150, 1, 9, spread=0.5)
    lens, X_CF = Lens(), view(splat)
    stop = np.full((lens.height, lens.width), np.inf)
    stop[5:25, 8:40] = np.linspace(2.0, 4.5, 32)
    ellipses = project(splat, X_CF, lens)
    image = composite(ellipses, lens, stop)
    color, alpha, depth = directly(splat, X_CF, lens, stop)
    np.testing.assert_allclose(image.color, color, atol=3e-4)
    np.testing.assert_allclose(image.alpha, alpha, atol=3e-4)
    np.testing.assert_allclose(image.depth, depth, atol=1e-9)
    wanted = np.zeros_like(stop, dtype=bool)
    wanted[10:20, 4:30] = True
    part = composite(ellipses, lens, stop, wanted)
    np.testing.assert_allclose(part.color[wanted], image.color[wanted], atol=1e-9)
    assert not part.alpha[~wanted].any() and not part.color[~wanted].any()


def test_a_large_image_is_rendered_in_bands(monkeypatch: pytest.MonkeyPatch) -> None:
    splat = random_splat(60, 0, 2, spread=0.5)
    lens, X_CF = Lens(), view(splat)
    whole = splat_image(splat, X_CF, lens)
    monkeypatch.setattr("simfoundry.splats.raster._PIXELS", 5 * lens.width)
    monkeypatch.setattr("simfoundry.splats.raster._PAIRS", 700)
    bands = splat_image(splat, X_CF, lens)
    # Far from their centers, Gaussians may change places at the borders of batches.
    np.testing.assert_allclose(bands.color, whole.color, atol=1e-3)
    assert (np.abs(bands.depth - whole.depth) < 1e-9).mean() > 0.99


def test_an_empty_view_is_empty() -> None:
    splat = random_splat(5, 0, seed=2)
    image = splat_image(splat, Pose.of((0, 0, -1000)), Lens())
    assert not image.alpha.any() and not image.color.any() and not image.farthest.any()


@pytest.mark.slow
def test_100_000_gaussians_take_less_than_two_and_a_half_seconds() -> None:
    rng = np.random.default_rng(0)
    n = 100_000
    splat = gaussian_splat(
        "room",
        positions=rng.uniform(-1, 1, (n, 3)) * [1.2, 0.9, 0.3] + [0, 0, 2.2],
        scales=np.exp(rng.normal(np.log(0.02), 0.5, (n, 3))),
        rotations=rng.normal(size=(n, 4)),
        opacities=1 / (1 + np.exp(-rng.normal(1, 2, n))),
        harmonics=rng.normal(0, 0.4, (n, 16, 3)),
    )
    start = time.process_time()  # a test machine may be busy with others
    image = splat_image(splat, Pose.of(), Lens(320, 240, 260.0, 260.0, 159.5, 119.5))
    assert time.process_time() - start < 2.5
    assert image.alpha.mean() > 0.99


SCENE = """\
simfoundry: scene/1
name: desk
objects:
  cube: {shape: {box: [0.2, 0.2, 0.2]}, mass: 1, color: "#20a040", pose: {xyz: [0.5, 0, 0]}, fixed: true}
cameras:
  front: {size: [64, 48], fx: 60, fy: 60, pose: {xyz: [-0.5, 0, 0], look_at: [0.5, 0, 0]}}
background: {splat: walls.ply, pose: {xyz: [0, 0, 0.5], yaw_deg: 90}, scale: 0.5}
"""


def wall(x: float, y: tuple[float, float], rgb: tuple[float, float, float]) -> list[tuple[float, ...]]:
    """Return opaque Gaussians on a wall across the view at x, in the axes of a file that is turned and scaled."""
    grid = np.stack(np.meshgrid(np.arange(*y, 0.04), np.arange(-1.2, 1.2, 0.04)), axis=-1).reshape(-1, 2)
    coefficients = [(c - 0.5) / SH0 for c in rgb]
    # p_W = 0.5 * Rz(90 deg) p_F + (0, 0, 0.5)
    return [(2 * b, -2 * x, 2 * (c - 0.5), *coefficients) for b, c in grid.tolist()]


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """A cube before a red wall; a blue wall stands before the right half of the cube as the camera sees it."""
    folder = tmp_path_factory.mktemp("desk")
    rows = np.array(wall(1.5, (-2, 2), (0.9, 0.1, 0.1)) + wall(0.1, (-0.6, 0.0), (0.1, 0.2, 0.9)))
    n = len(rows)
    scales = np.full((n, 3), 2 * 0.03)
    scales[:, 1] = 1e-3  # flat along y of the file, which is -x of the world
    splat = gaussian_splat("walls", rows[:, :3], scales, np.tile([1.0, 0, 0, 0], (n, 1)), np.ones(n), rows[:, None, 3:])
    (folder / "walls.ply").write_bytes(splat_bytes(splat, "walls.ply"))
    (folder / "desk.scene.yaml").write_text(SCENE)
    return lower_file(folder / "desk.scene.yaml")


# Row and column of a pixel of the red wall, of the cube, and of the blue wall before the cube and beside it.
RED, CUBE, BLUE = (6, 6), (24, 28), [(24, 36), (6, 40)]


def check_colors(image: np.ndarray, tolerance: float = 3.0) -> None:
    np.testing.assert_allclose(image[RED], np.array([0.9, 0.1, 0.1]) * 255, atol=tolerance)
    for place in BLUE:
        np.testing.assert_allclose(image[place], np.array([0.1, 0.2, 0.9]) * 255, atol=tolerance)
    red, green, blue = image[CUBE].astype(int)
    assert green > red + 30 and green > blue + 30


@pytest.mark.parametrize("samples", [1, 2])
def test_objects_hide_the_splat_behind_them_and_are_hidden_by_the_one_before_them(desk: Scene, samples: int) -> None:
    seen = raycast(desk, desk.cameras[0], samples=samples)
    check_colors(seen.color)
    assert seen.depth[RED] == pytest.approx(2.0, abs=1e-3) and seen.depth[BLUE[0]] == pytest.approx(0.6, abs=1e-3)
    assert seen.depth[CUBE] == pytest.approx(0.9, abs=1e-6)
    assert (seen.objects[RED], seen.objects[CUBE], seen.objects[BLUE[0]]) == (0, 1, 0)
    assert np.isnan(seen.normals[BLUE[0]]).all() and not np.isnan(seen.normals[CUBE]).any()
    check_colors(quick_image(desk, desk.cameras[0]))


@pytest.mark.parametrize("engine", ["mujoco", "pybullet"])
def test_worlds_show_the_splat_and_follow_their_objects(desk: Scene, engine: str) -> None:
    pytest.importorskip(engine)
    with open_world(desk, engine) as world:
        check_colors(world.render("front", 64, 48))


def test_a_static_camera_is_projected_once(desk: Scene) -> None:
    assert splat_backdrop(desk, desk.cameras[0]) is splat_backdrop(desk, desk.cameras[0])


def test_an_outline_blends_the_object_with_the_splat(desk: Scene) -> None:
    """Between the cube and the wall behind it, no pixel has a color that neither of them has, such as the sky's."""
    with open_world(desk, "mujoco") as world:
        row = world.render("front", 64, 48)[24, 18:28].astype(int)
    assert (np.diff(row[:, 0]) <= 2).all() and row[0, 0] > 220 and row[-1, 0] < 100  # from red to green
    assert row[:, 2].max() < 130
