"""Pictures of a scene, by MuJoCo's renderer where there is a GL driver, by the ray caster where there is none."""

from __future__ import annotations

import logging
import os
import subprocess
import sys
import tempfile
from enum import StrEnum
from functools import cache
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from simfoundry.scene.frames import Pose
from simfoundry.scene.model import Camera, Scene
from simfoundry.scene.raycast import raycast
from simfoundry.scene.state import SceneState

if TYPE_CHECKING:
    import mujoco

Image = NDArray[np.uint8]

VISUAL_GROUP, COLLIDER_GROUP = 2, 3
"""The geom groups of the MJCF backend; only the first is drawn."""

NEAR, FAR = 0.01, 100.0
"""Clipping distances of a GL picture [m]."""

_LOG = logging.getLogger(__name__)

_PROBE = """
import importlib, mujoco
gl = importlib.import_module("mujoco.{engine}").GLContext(64, 64)
gl.make_current()
mujoco.MjrContext(mujoco.MjModel.from_xml_string("<mujoco/>"), mujoco.mjtFontScale.mjFONTSCALE_100)
print("drawn")
"""


class Engine(StrEnum):
    """What draws: MuJoCo with one of two GL drivers, our own ray caster, or the first of the three that works."""

    AUTO = "auto"
    EGL = "egl"
    OSMESA = "osmesa"
    RAYCAST = "raycast"


class RenderError(Exception):
    """A picture cannot be drawn as asked; the message says why and what to do."""


def render(scene: Scene, camera: Camera, state: SceneState | None = None, engine: Engine | str = Engine.AUTO) -> Image:
    """Draw ``scene`` in ``state`` (by default the state it describes) as ``camera`` sees it: sRGB, uint8, (h, w, 3).

    Intrinsics are exact with every engine, principal point and fx != fy included. Which engine ``auto`` takes is logged
    and is what :func:`choose_engine` returns. Raises :class:`RenderError` for an engine that does not work here.
    """
    chosen = choose_engine(engine)
    _LOG.info("drawing %s/%s with %s", scene.name, camera.name, chosen)
    if chosen is Engine.RAYCAST:
        return raycast(scene, camera, state, samples=2).color
    model, data = load_mujoco(scene, state)
    with MujocoRenderer(model, camera.width, camera.height, chosen) as renderer:
        return renderer.picture(data, camera)


def choose_engine(engine: Engine | str = Engine.AUTO) -> Engine:
    """The engine that draws when ``engine`` is asked for. Raises :class:`RenderError` if it does not work here."""
    try:
        wanted = Engine(engine)
    except ValueError:
        raise RenderError(f"no render engine {engine!r}; there are: {', '.join(Engine)}") from None
    if wanted is Engine.AUTO:
        drivers = [Engine.EGL, Engine.OSMESA]
        preferred = os.environ.get("MUJOCO_GL", "").lower()
        drivers.sort(key=lambda d: d.value != preferred)
        return next((d for d in drivers if _obstacle(d) is None), Engine.RAYCAST)
    if wanted is not Engine.RAYCAST and (reason := _obstacle(wanted)) is not None:
        raise RenderError(f"{wanted} does not work here ({reason}); use 'raycast', which needs no GL driver")
    return wanted


def working_drivers() -> list[str]:
    """The GL drivers that MuJoCo can draw with here."""
    return [engine.value for engine in (Engine.EGL, Engine.OSMESA) if _obstacle(engine) is None]


def _obstacle(engine: Engine) -> str | None:
    """Why MuJoCo cannot draw with this driver in this process, or None if it can."""
    platform = os.environ.get("PYOPENGL_PLATFORM", "").lower()
    if platform not in ("", engine.value):  # PyOpenGL binds to one driver for the life of a process
        return f"this process has already chosen the GL driver {platform!r}"
    return _probe(engine)


@cache
def _probe(engine: Engine) -> str | None:
    """Try the driver in a process of its own: a failed attempt would spoil this one for the other driver."""
    own = {k: v for k, v in os.environ.items() if k not in ("MUJOCO_GL", "PYOPENGL_PLATFORM")}
    command = [sys.executable, "-c", _PROBE.format(engine=engine.value)]
    try:
        done = subprocess.run(command, env=own, capture_output=True, text=True, timeout=60, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        return f"the trial run failed: {error}"
    if "drawn" in done.stdout:
        return None
    lines = done.stderr.strip().splitlines()
    return lines[-1] if lines else f"the trial run ended with status {done.returncode}"


def load_mujoco(scene: Scene, state: SceneState | None = None) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Compile ``scene`` to MJCF and load it, posed in ``state`` (by default the state that the scene describes)."""
    import mujoco

    from simfoundry.backends.mjcf import compile_mjcf

    artifact = compile_mjcf(scene)
    with tempfile.TemporaryDirectory() as folder:
        artifact.write(Path(folder) / "mjcf")
        model = mujoco.MjModel.from_xml_path(str(Path(folder) / "mjcf" / artifact.entry))
    data = mujoco.MjData(model)
    pose_mujoco(model, data, SceneState.initial(scene) if state is None else state)
    return model, data


def pose_mujoco(model: mujoco.MjModel, data: mujoco.MjData, state: SceneState) -> None:
    """Put the objects and joints of a model of the MJCF backend where ``state`` says; what it omits stays."""
    import mujoco

    for name, X_WO in state.poses.items():
        body = model.body(name)
        address = int(model.body_jntadr[body.id])
        if address >= 0 and model.jnt_type[address] == mujoco.mjtJoint.mjJNT_FREE:
            start = int(model.jnt_qposadr[address])
            data.qpos[start : start + 7] = np.concatenate([X_WO.p, X_WO.q])
        else:  # welded to the world: only the model can move it
            model.body_pos[body.id], model.body_quat[body.id] = X_WO.p, X_WO.q
    for name, position in state.joints.items():
        data.qpos[model.joint(name).qposadr[0]] = position
    mujoco.mj_forward(model, data)


class MujocoRenderer:
    """Draws one MuJoCo model off-screen; close it, or use it in a ``with`` statement.

    ``width`` and ``height`` [px] are the largest picture it will draw.
    """

    def __init__(self, model: mujoco.MjModel, width: int, height: int, engine: Engine = Engine.AUTO) -> None:
        import importlib

        import mujoco

        chosen = choose_engine(engine)
        if chosen is Engine.RAYCAST:
            raise RenderError("MuJoCo finds no GL driver: install libegl1 and libgl1-mesa-dri, or libosmesa6")
        self.engine = chosen
        self._model = model
        self._size = (width, height)
        model.vis.global_.offwidth = max(width, model.vis.global_.offwidth)
        model.vis.global_.offheight = max(height, model.vis.global_.offheight)
        self._gl: Any = importlib.import_module(f"mujoco.{chosen.value}").GLContext(
            model.vis.global_.offwidth, model.vis.global_.offheight
        )
        self._gl.make_current()
        self._context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
        self._scene = mujoco.MjvScene(model, maxgeom=max(1000, 4 * model.ngeom))
        self._option = mujoco.MjvOption()
        self._option.geomgroup[:] = 0
        self._option.geomgroup[VISUAL_GROUP] = 1

    def picture(self, data: mujoco.MjData, camera: Camera) -> Image:
        """What ``camera`` sees: sRGB, uint8, shape (h, w, 3)."""
        return self._draw(data, camera)

    def geoms(self, data: mujoco.MjData, camera: Camera) -> NDArray[np.int32]:
        """Which geom each pixel shows, shape (h, w): 0 for none, else 1 + the geom's id."""
        import mujoco

        flags = self._scene.flags
        flags[mujoco.mjtRndFlag.mjRND_SEGMENT] = flags[mujoco.mjtRndFlag.mjRND_IDCOLOR] = 1
        try:
            rgb = self._draw(data, camera).astype(np.int32)
        finally:
            flags[mujoco.mjtRndFlag.mjRND_SEGMENT] = flags[mujoco.mjtRndFlag.mjRND_IDCOLOR] = 0
        drawn = rgb[..., 0] + (rgb[..., 1] << 8) + (rgb[..., 2] << 16)  # 1 + the index in the scene's list
        geom = np.zeros(self._scene.ngeom + 1, dtype=np.int32)
        for item in self._scene.geoms[: self._scene.ngeom]:
            if item.segid >= 0 and item.objtype == mujoco.mjtObj.mjOBJ_GEOM:
                geom[item.segid + 1] = item.objid + 1
        return np.asarray(geom[np.where(drawn < len(geom), drawn, 0)], dtype=np.int32)

    def _draw(self, data: mujoco.MjData, camera: Camera) -> Image:
        import mujoco

        if camera.width > self._size[0] or camera.height > self._size[1]:
            raise RenderError(
                f"camera {camera.name!r} is {camera.width}x{camera.height}, the renderer was made for "
                f"{self._size[0]}x{self._size[1]}: make it with the size of the largest camera"
            )
        self._gl.make_current()
        free = mujoco.MjvCamera()
        mujoco.mjv_updateScene(
            self._model, data, self._option, None, free, mujoco.mjtCatBit.mjCAT_ALL.value, self._scene
        )
        for view in self._scene.camera:
            _aim(view, camera)
        viewport = mujoco.MjrRect(0, 0, camera.width, camera.height)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)
        mujoco.mjr_render(viewport, self._scene, self._context)
        picture = np.empty((camera.height, camera.width, 3), dtype=np.uint8)
        mujoco.mjr_readPixels(picture, None, viewport, self._context)
        return np.ascontiguousarray(picture[::-1])  # GL counts rows from the bottom

    def close(self) -> None:
        """Free the driver's memory; the renderer cannot be used afterwards."""
        self._gl.make_current()
        self._context.free()
        self._gl.free()

    def __enter__(self) -> MujocoRenderer:
        """The renderer itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close it."""
        self.close()


def _aim(view: mujoco.MjvGLCamera, camera: Camera) -> None:
    """Give a GL camera the pose and the frustum of ours; pixel centres are integers, so the image begins at -0.5."""
    X_WC: Pose = camera.X_WC
    R_WC = X_WC.rotation
    view.pos, view.forward, view.up = X_WC.p, R_WC[:, 2], -R_WC[:, 1]
    view.orthographic = 0
    view.frustum_near, view.frustum_far = NEAR, FAR
    view.frustum_center = NEAR * ((camera.width - 1) / 2 - camera.cx) / camera.fx
    view.frustum_width = NEAR * camera.width / 2 / camera.fx
    view.frustum_top = NEAR * (camera.cy + 0.5) / camera.fy
    view.frustum_bottom = NEAR * (camera.cy + 0.5 - camera.height) / camera.fy
