"""Pictures of scenes of cousins."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from simfoundry.scene.model import Camera, Scene
    from simfoundry.spec.models.scene import SceneSpec

WIDTH = 384
"""Of a picture [px]."""


def draw(file: Path) -> bytes | None:
    """A PNG of a scene from its viewpoint, or its first camera; None where it has no camera."""
    from simfoundry.assets.cache import Cache
    from simfoundry.render.montage import png_bytes
    from simfoundry.scene.lower import lower
    from simfoundry.spec.load import load_scene
    from simfoundry.spec.models.scene import SceneSpec
    from simfoundry.worlds.render import render

    loaded = load_scene(file)
    assert isinstance(loaded.spec, SceneSpec)
    scene = lower(loaded, Cache.default())
    camera = view(scene, loaded.spec)
    return None if camera is None else png_bytes(render(scene, camera))


def view(scene: Scene, spec: SceneSpec) -> Camera | None:
    """The camera of the viewpoint, or the first, with a small picture; None without cameras."""
    cameras = {camera.name: camera for camera in scene.cameras}
    camera = cameras.get(spec.viewpoint or "") or next(iter(cameras.values()), None)
    if camera is None:
        return None
    scale = WIDTH / camera.width
    height = max(1, round(camera.height * scale))
    cx, cy = scale * (camera.cx + 0.5) - 0.5, scale * (camera.cy + 0.5) - 0.5
    return replace(camera, width=WIDTH, height=height, fx=camera.fx * scale, fy=camera.fy * scale, cx=cx, cy=cy)
