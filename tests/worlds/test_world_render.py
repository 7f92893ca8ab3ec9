"""What worlds show of themselves: the same things at the same pixels, robots included, and nothing moves by looking."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from simfoundry.render.gl import Engine, RenderError, choose_engine
from simfoundry.render.offscreen import MujocoRenderer, coarsened
from simfoundry.scene.model import Camera
from simfoundry.worlds.base import Image, World, camera_of, resized
from simfoundry.worlds.mujoco_world import SMALL, MujocoWorld
from simfoundry.worlds.pybullet_world import PybulletWorld
from tests.evaluate.benches import write_bench
from tests.tabletop import front_camera, tabletop


@pytest.fixture(scope="module", params=["mujoco", "pybullet"])
def world(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[World]:
    from simfoundry.scene.lower import lower_file

    scene = lower_file(write_bench(tmp_path_factory.mktemp("bench")).with_name("bench.scene.yaml"))
    if request.param == "pybullet":
        pytest.importorskip("pybullet", reason="PyBullet has wheels only for Python 3.11 on Linux")
        with PybulletWorld(scene) as opened:
            yield opened
    else:
        need_gl()
        with MujocoWorld(scene) as made:
            yield made


def need_gl() -> None:
    if choose_engine() is Engine.RAYCAST:
        pytest.skip("no GL driver")


def red(picture: Image) -> np.ndarray:
    """Where the arm is, which is red as nothing else."""
    r, g, b = (picture[..., k].astype(int) for k in range(3))
    return (r > 60) & (r > 2 * g) & (r > 2 * b)


def test_a_picture_shows_the_robot_where_it_is(world: World) -> None:
    world.reset()
    before = world.render("top", 200, 200)
    assert before.shape == (200, 200, 3) and before.dtype == np.uint8
    assert red(before).sum() > 150
    world.robot("arm").set_targets({"turn": 0.8})
    world.step(500)
    after = world.render("top", 200, 200)
    assert red(after).sum() > 150 and (red(before) & ~red(after)).sum() > 50
    tip = world.robot("arm").frame("boom").apply(np.array([0.2, 0.0, 0.0]))
    seen = camera_of(world, "top", 200, 200)
    x, y, z = seen.X_WC.inverse().apply(tip)
    column, row = round(seen.fx * x / z + seen.cx), round(seen.fy * y / z + seen.cy)
    assert red(after)[row - 1 : row + 2, column - 1 : column + 2].any()


def test_a_mounted_camera_rides_along(world: World) -> None:
    world.reset()
    before = camera_of(world, "tip", 64, 48).X_WC
    first = world.render("tip", 64, 48)
    world.robot("arm").set_targets({"turn": 0.8})
    world.step(500)
    assert camera_of(world, "tip", 64, 48).X_WC.angle_to(before) == pytest.approx(0.8, abs=0.05)
    assert np.abs(world.render("tip", 64, 48).astype(int) - first.astype(int)).mean() > 3


def test_sizes_do_not_evict_each_other(monkeypatch: pytest.MonkeyPatch) -> None:
    need_gl()
    made = []

    def counting(*args: object, **options: object) -> MujocoRenderer:
        made.append(args[1:])
        return MujocoRenderer(*args, **options)  # type: ignore[arg-type]

    with MujocoWorld(tabletop()) as world, MujocoWorld(tabletop()) as other:
        fresh = other.render("front", 48, 96)
        monkeypatch.setattr("simfoundry.worlds.mujoco_world.MujocoRenderer", counting)
        sizes = [(96, 48), (48, 96), (SMALL + 2, 40), (40, 30)]
        for _ in range(3):
            pictures = [world.render("front", *size) for size in sizes]
        # one for small pictures, which grew once, and one for large ones
        assert made == [(96, 48), (96, 96), (SMALL + 2, 40)]
        np.testing.assert_array_equal(pictures[1], fresh)


def test_pictures_are_cut_not_squeezed(world: World) -> None:
    world.reset()
    wide, square = world.render("front", 320, 160), world.render("front", 160, 160)
    # 640 x 480: the wide one loses above and below, the square one left and right, at the same scale in the end
    assert wide.shape == (160, 320, 3) and square.shape == (160, 160, 3)
    whole = world.render("front", 320, 240)
    assert np.abs(whole[40:200].astype(int) - wide.astype(int)).mean() < 2


def test_a_camera_that_is_not_there_is_named(world: World) -> None:
    with pytest.raises(KeyError, match="no camera 'frnt'; available cameras: front, top, tip"):
        world.render("frnt", 8, 8)


@pytest.mark.parametrize("size", [(-3, 4), (0, 0), (8, 10**6)])
def test_a_picture_of_no_size_is_refused(world: World, size: tuple[int, int]) -> None:
    with pytest.raises(RenderError, match=f"1 to 8192 pixels per side, but {size[0]} x {size[1]} were requested"):
        world.render("front", *size)


def test_looking_moves_nothing(world: World) -> None:
    def run(looks: bool) -> np.ndarray:
        world.reset()
        world.robot("arm").set_targets({"turn": 0.3, "reach": 0.2})
        for _ in range(20):
            world.step(10)
            if looks:
                world.render("front", 32, 24)
        return np.concatenate([[*pose.p, *pose.q] for pose in world.state().poses.values()])

    run(False)  # what tests before this one did may still be felt once in Bullet
    first, looked = run(False), run(True)
    if isinstance(world, MujocoWorld):
        np.testing.assert_array_equal(first, looked)
    else:
        np.testing.assert_allclose(first, looked, rtol=0, atol=1e-12)  # Bullet's last digits differ from run to run


def test_a_resized_camera_sees_along_the_same_rays() -> None:
    camera: Camera = front_camera(640, 480)
    small = resized(camera, 160, 120)
    # the left edge of the picture lies at -0.5
    assert (-0.5 - small.cx) / small.fx == pytest.approx((-0.5 - camera.cx) / camera.fx)
    assert (119.5 - small.cy) / small.fy == pytest.approx((479.5 - camera.cy) / camera.fy)
    assert resized(camera, 640, 480) == camera
    square = resized(camera, 120, 120)
    assert square.fx == square.fy == pytest.approx(small.fy)
    assert (59.5 - square.cx) / square.fx == pytest.approx((79.5 - small.cx) / small.fx)


def test_quick_pictures_look_like_careful_ones() -> None:
    need_gl()
    with MujocoWorld(tabletop()) as world:
        camera = front_camera(160, 120)
        with (
            MujocoRenderer(world.model, 160, 120) as careful,
            MujocoRenderer(world.model, 160, 120, quick=True) as quick,
        ):
            world.reset()
            a, b = (r.picture(world.data, camera).astype(int) for r in (careful, quick))
        assert a.shape == b.shape and np.abs(a - b).mean() < 1.5
        assert max(a.shape) <= SMALL


def test_coarse_meshes_lose_triangles_and_keep_their_shape() -> None:
    import mujoco

    rng = np.random.default_rng(0)
    points = rng.normal(size=(4000, 3))
    points *= 0.04 / np.linalg.norm(points, axis=1, keepdims=True)
    spec = mujoco.MjSpec()
    spec.add_mesh(name="ball", uservert=points.ravel())
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="ball")
    model = spec.compile()
    drawn = coarsened(model)
    few = int(drawn.mesh_facenum[0])
    assert 500 < few < model.mesh_facenum[0] / 2
    middle = drawn.mesh_vert[drawn.mesh_face[:few]].mean(axis=1)
    assert np.abs(np.linalg.norm(middle, axis=1) - 0.04).max() < 1e-3  # no triangle strays from the ball by more
    assert model.mesh_facenum[0] > 7000  # the model itself stays whole
