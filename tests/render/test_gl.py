"""Engines agree about what a camera sees, and say clearly when they cannot draw."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest
from numpy.typing import NDArray

from simfoundry.geometry.frames import Pose, frozen_array, look_at, quat_from_rpy
from simfoundry.render.gl import Engine, RenderError, choose_engine
from simfoundry.render.montage import label_color, overlay, png_bytes, save_png, side_by_side
from simfoundry.render.offscreen import MujocoRenderer, _aim
from simfoundry.render.raycast import raycast
from simfoundry.scene.model import Camera, Light, LightType
from simfoundry.scene.state import SceneState
from simfoundry.worlds.mujoco_world import MujocoWorld
from simfoundry.worlds.render import render
from tests.tabletop import front_camera, tabletop

OPEN = SceneState.of({"apple": Pose.of([0.35, 0.02, 0.2])}, {"cabinet.drawer": 0.09})


def skewed_camera() -> Camera:
    X_WC = look_at(np.array([-0.2, 0.35, 0.6]), np.array([0.5, 0.0, 0.0])) @ Pose.of(q=quat_from_rpy(0, 0, 0.15))
    return Camera("skewed", 400, 300, 430.0, 370.0, 231.4, 118.7, X_WC)


def need(engine: Engine) -> None:
    try:
        choose_engine(engine)
    except RenderError as error:
        pytest.skip(f"no GL driver: {error}")


def test_auto_always_finds_an_engine_and_unknown_names_are_refused() -> None:
    assert choose_engine() in (Engine.EGL, Engine.OSMESA, Engine.RAYCAST)
    with pytest.raises(
        RenderError, match="unknown render engine 'vulkan'; available engines: auto, egl, osmesa, raycast"
    ):
        choose_engine("vulkan")


def test_a_driver_that_the_process_cannot_change_to_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYOPENGL_PLATFORM", "glx")
    with pytest.raises(RenderError, match=r"egl is not available \(.*'glx'\); use 'raycast'"):
        choose_engine("egl")
    assert choose_engine() is Engine.RAYCAST


def test_without_a_driver_the_ray_caster_draws() -> None:
    scene, camera = tabletop(), front_camera(96, 72)
    np.testing.assert_array_equal(render(scene, camera, OPEN, "raycast"), raycast(scene, camera, OPEN, samples=2).color)


def iou(a: NDArray[np.bool_], b: NDArray[np.bool_]) -> float:
    return float((a & b).sum() / (a | b).sum())


def test_mujoco_and_the_ray_caster_see_each_object_at_the_same_pixels() -> None:
    need(Engine.EGL)
    scene, camera = tabletop(), skewed_camera()
    seen = raycast(scene, camera, OPEN).objects
    with MujocoWorld(scene) as world:
        world.reset(OPEN)
        with MujocoRenderer(world.model, camera.width, camera.height, Engine.EGL) as renderer:
            geoms = renderer.geoms(world.data, camera)
            picture = renderer.picture(world.data, camera)
        root = np.concatenate([[-1], world.model.body_rootid[world.model.geom_bodyid]])
        for number, item in enumerate(scene.objects, start=1):
            drawn = root[geoms] == world.model.body(item.name).id
            assert (seen == number).sum() > 200, item.name
            # MuJoCo draws round shapes with 28 slices; 97% leaves it the outline of a small plate.
            assert iou(seen == number, drawn) > 0.97, item.name
    np.testing.assert_array_equal(render(scene, camera, OPEN, Engine.EGL), picture)


def test_mujoco_and_the_ray_caster_paint_alike() -> None:
    need(Engine.EGL)
    scene, camera = tabletop(), skewed_camera()
    seen = raycast(scene, camera, OPEN)
    ours, theirs = seen.color.astype(float), render(scene, camera, OPEN, "egl").astype(float)
    assert np.abs(ours - theirs).mean() < 30
    assert np.corrcoef(ours.ravel(), theirs.ravel())[0, 1] > 0.9
    assert np.percentile(theirs[seen.objects == 0], 2) > 200  # the backdrop, not black


def test_every_engine_uses_the_camera_that_the_mjcf_names() -> None:
    """The frustum we set and the one MuJoCo derives from the compiled camera are the same up to its near plane."""
    from dataclasses import replace

    import mujoco

    scene = replace(tabletop(), cameras=(skewed_camera(),))
    with MujocoWorld(scene) as world:
        view = mujoco.MjvScene(world.model, maxgeom=200)
        named = mujoco.MjvCamera()
        named.type, named.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, world.model.camera("skewed").id
        option = mujoco.MjvOption()
        mujoco.mjv_updateScene(world.model, world.data, option, None, named, mujoco.mjtCatBit.mjCAT_ALL.value, view)
        fields = ("frustum_center", "frustum_width", "frustum_bottom", "frustum_top")
        theirs = view.camera[0]
        facts = [getattr(theirs, f) / theirs.frustum_near for f in fields] + [*theirs.pos, *theirs.forward, *theirs.up]
        _aim(theirs, skewed_camera())
        ours = [getattr(theirs, f) / theirs.frustum_near for f in fields] + [*theirs.pos, *theirs.forward, *theirs.up]
    # Positions of a fixed camera are the mean of both eyes, moved apart by a few centimeters.
    np.testing.assert_allclose(facts[:4] + facts[7:], ours[:4] + ours[7:], atol=1e-5)
    np.testing.assert_allclose(facts[4:7], ours[4:7], atol=0.05)


def test_scene_lights_reach_mujoco() -> None:
    need(Engine.EGL)
    turned = Pose.of(q=quat_from_rpy(0.3, -0.2, 0.0))
    lamp = Light("sun", LightType.DISTANT, 0.6, frozen_array([1.0, 0.2, 0.2]), turned)
    red = render(tabletop((lamp,)), front_camera(96, 72), engine="egl").astype(float)
    plain = render(tabletop(), front_camera(96, 72), engine="egl").astype(float)
    assert (red[40:, :, 0] / np.maximum(red[40:, :, 2], 1)).mean() > 2 * (plain[40:, :, 0] / plain[40:, :, 2]).mean()


def test_the_renderer_refuses_what_is_larger_than_its_buffer() -> None:
    need(Engine.EGL)
    with MujocoWorld(tabletop()) as world, MujocoRenderer(world.model, 64, 48, Engine.EGL) as renderer:
        assert renderer.picture(world.data, front_camera(64, 48)).shape == (48, 64, 3)
        with pytest.raises(RenderError, match="'front' is 96x72, but the renderer was created for 64x48"):
            renderer.picture(world.data, front_camera(96, 72))


def test_osmesa_draws_in_a_process_of_its_own_what_egl_draws_here() -> None:
    need(Engine.EGL)
    code = (
        "import sys; from simfoundry.worlds.render import *; from tests.tabletop import *\n"
        "try: choose_engine('osmesa')\n"
        "except RenderError as error: sys.exit(f'skip: {error}')\n"
        "sys.stdout.buffer.write(render(tabletop(), front_camera(96, 72), engine='osmesa').tobytes())"
    )
    env = {k: v for k, v in os.environ.items() if k not in ("PYOPENGL_PLATFORM", "MUJOCO_GL")}
    env["PYTHONPATH"] = ":".join(sys.path)
    done = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, check=False)
    if done.stderr.decode().startswith("skip"):
        pytest.skip(f"no GL driver: {done.stderr.decode().removeprefix('skip: ')}")
    assert done.returncode == 0, done.stderr.decode()
    theirs = np.frombuffer(done.stdout, dtype=np.uint8).reshape(72, 96, 3).astype(float)
    ours = render(tabletop(), front_camera(96, 72), engine="egl").astype(float)
    assert np.abs(ours - theirs).mean() < 4


def panel(height: int, width: int, value: int) -> NDArray[np.uint8]:
    return np.full((height, width, 3), value, dtype=np.uint8)


def ink_above(page: NDArray[np.uint8]) -> bool:
    """Whether anything dark stands above pictures 100 px high."""
    return bool(np.any(page[: page.shape[0] - 104].max(axis=-1) < 90))


def test_panels_get_one_height_keep_their_proportions_and_carry_a_caption() -> None:
    page = side_by_side([("left", panel(100, 150, 10)), ("right", panel(200, 100, 90))])
    assert ((page == 10).all(axis=-1)).sum() == 100 * 150
    assert ((page == 90).all(axis=-1)).sum() == 100 * 50
    assert ink_above(page)
    unnamed = side_by_side([("", panel(100, 150, 10)), ("", panel(200, 100, 90))])
    assert unnamed.shape == page.shape and not ink_above(unnamed)
    two_rows = side_by_side([("a", panel(60, 80, 1)), ("b", panel(60, 80, 2)), ("c", panel(60, 80, 3))], columns=2)
    assert two_rows.shape[0] > 2 * 60 and two_rows.shape[1] < 3 * 80
    with pytest.raises(ValueError, match="at least one image"):
        side_by_side([])


def test_overlay_tints_each_object_outlines_it_and_leaves_the_rest() -> None:
    color, objects = panel(20, 30, 100), np.zeros((20, 30), dtype=np.int32)
    objects[4:10, 5:15], objects[12:18, 5:15] = 1, 7
    out = overlay(color, objects, alpha=0.5)
    np.testing.assert_array_equal(out[objects == 0], color[objects == 0])
    for label, (v, u) in {1: (7, 9), 7: (15, 9)}.items():
        np.testing.assert_allclose(out[v, u], 50 + np.array(label_color(label)) / 2, atol=0.51)
        np.testing.assert_array_equal(out[v, 5], label_color(label))
    assert len({label_color(k) for k in range(1, 40)}) == 39
    with pytest.raises(ValueError, match="but the image has shape"):
        overlay(color, objects[:-1])


def test_a_png_has_the_same_bytes_each_time(tmp_path: object) -> None:
    from pathlib import Path

    path = Path(str(tmp_path)) / "new" / "a.png"
    image = raycast(tabletop(), front_camera(64, 48)).color
    save_png(path, image)
    assert path.read_bytes() == png_bytes(image.copy())
