"""Rendering of scene images, which uses MuJoCo's renderer if a GL driver is available and the ray caster otherwise."""

from __future__ import annotations

import logging

import numpy as np
from numpy.typing import NDArray

from simfoundry.render.backdrop import splat_backdrop
from simfoundry.render.gl import Engine, RenderError, choose_engine
from simfoundry.render.offscreen import MujocoRenderer
from simfoundry.render.raycast import raycast
from simfoundry.scene.model import Camera, Scene
from simfoundry.scene.state import SceneState
from simfoundry.worlds.mujoco_world import MujocoWorld

__all__ = ["Engine", "RenderError", "choose_engine", "render"]

Image = NDArray[np.uint8]

_LOG = logging.getLogger(__name__)


def render(scene: Scene, camera: Camera, state: SceneState | None = None, engine: Engine | str = Engine.AUTO) -> Image:
    """Render ``scene`` in ``state``, or in its initial state by default, with ``camera``.

    All engines use exact intrinsics, including the principal point and unequal fx and fy. For ``auto``,
    :func:`choose_engine` selects the engine, which is logged.

    Returns:
        An sRGB image, uint8, shape (h, w, 3).

    Raises:
        RenderError: If the engine does not work on this system.
    """
    chosen = choose_engine(engine)
    _LOG.info("rendering %s/%s with %s", scene.name, camera.name, chosen)
    if chosen is Engine.RAYCAST:
        return raycast(scene, camera, state, samples=2).color
    with MujocoWorld(scene) as world:
        world.reset(state)
        with MujocoRenderer(world.model, camera.width, camera.height, chosen) as renderer:
            return renderer.picture(world.data, camera, splat_backdrop(scene, camera))
