"""Pictures of scenes and objects for an editor, without a display."""

from __future__ import annotations

import base64
import hashlib
import io
import math
import pickle
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from threading import Lock

import numpy as np
from numpy.typing import NDArray

from simfoundry.geometry.frames import Pose
from simfoundry.language_server.analysis import Analysis
from simfoundry.lint.draft import DraftScene, drafted_start, pictured, pictured_asset
from simfoundry.render.raycast import quick_image
from simfoundry.render.views import Orbit, default_orbit, framing, orbit_camera, overview, shrunk
from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.model import Camera, Scene, SceneObject
from simfoundry.spec.diagnostics import SpecError
from simfoundry.spec.files import Loaded
from simfoundry.spec.models.asset import AssetSpec
from simfoundry.spec.models.scene import SceneSpec
from simfoundry.spec.models.task import TaskSpec

# Width and height [px] of the picture of an object, and its maximum size [bytes], above which it is not shown.
OBJECT_SIZE = (160, 120)
MAX_OBJECT_BYTES = 20_000

# Number of pictures of objects that are kept, of at most 20 kB each.
MOST_KEPT = 256

# Default, minimum and maximum width or height [px] of the picture of a scene; a larger one takes seconds.
SCENE_SIZE, LEAST_SIDE, MOST_SIDE = (640, 480), 16, 1920

# Greatest elevation [deg] of a camera, below the pole at which its image would turn over.
HIGHEST_DEG = 89.5

# Nearest and farthest distance [m] of a camera from the center of a scene.
NEAREST_M, FARTHEST_M = 0.01, 1e4

# Direction [deg] from which an asset is looked at: its front, which faces x, and its left side.
FRONT_DEG = 40.0

Checkpoint = Callable[[], None]


@dataclass(frozen=True)
class ViewRequest:
    """A viewpoint on a scene. None stands for the default view.

    Attributes:
        azimuth_deg: The direction from the center of the scene to the camera, counterclockwise from x [deg].
        elevation_deg: The angle of this direction above the horizon [deg].
        distance: The distance of the camera from the center of the scene [m].
        width: The width of the image [px].
        height: The height of the image [px].
    """

    azimuth_deg: float | None = None
    elevation_deg: float | None = None
    distance: float | None = None
    width: int = SCENE_SIZE[0]
    height: int = SCENE_SIZE[1]

    @classmethod
    def of(cls, params: object) -> ViewRequest:
        """Read a request. Values that are not finite numbers are ignored, and the others are limited."""
        width, height = (_number(params, key) for key in ("width", "height"))
        azimuth, elevation, distance = (_number(params, key) for key in ("azimuth_deg", "elevation_deg", "distance"))
        return cls(
            None if azimuth is None else math.remainder(azimuth, 360),
            None if elevation is None else min(max(elevation, -HIGHEST_DEG), HIGHEST_DEG),
            None if distance is None else min(max(distance, NEAREST_M), FARTHEST_M),
            SCENE_SIZE[0] if width is None else round(min(max(width, LEAST_SIDE), MOST_SIDE)),
            SCENE_SIZE[1] if height is None else round(min(max(height, LEAST_SIDE), MOST_SIDE)),
        )


def _number(params: object, key: str) -> float | None:
    value = params.get(key) if isinstance(params, dict) else getattr(params, key, None)
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 1e9:
        return None
    return float(value)


@dataclass(frozen=True)
class ScenePicture:
    """A picture of a scene as PNG bytes, with its size [px] and the position of the camera."""

    png: bytes
    width: int
    height: int
    orbit: Orbit


@dataclass(frozen=True)
class VisibleScene:
    """The content of a picture of a document.

    Attributes:
        scene: The scene with all visuals.
        viewpoint: The name of the viewpoint of the scene, or empty.
        azimuth_deg: The direction from which it is looked at if there is no viewpoint [deg], or None for the usual one.
    """

    scene: Scene
    viewpoint: str = ""
    azimuth_deg: float | None = None


def visible_scene(analysis: Analysis) -> VisibleScene | None:
    """Return the scene that a document shows.

    A task shows its initial state, a recipe the twin, and an asset itself. Robots and backgrounds are not shown.

    Returns:
        The scene, or None if the document has none or cannot be lowered.
    """
    draft = analysis.draft
    if draft is not None and not draft.spec.lights and _has_all_visuals(draft):
        return VisibleScene(draft.scene, draft.spec.viewpoint or "")
    try:
        return _visible(analysis.loaded)
    except SpecError:
        return None


def _has_all_visuals(draft: DraftScene) -> bool:
    """Return True if no object of a draft has a mesh or a texture, which drafts do not show."""
    textured = any(material.texture is not None for material in draft.spec.materials.values())
    items = draft.spec.objects.values()
    plain = all(item.visual is None for item in items)
    return plain and not textured and all(link.visuals or not link.colliders for o in draft.scene.objects
                                          for link in o.links)  # fmt: skip


def _visible(loaded: Loaded) -> VisibleScene | None:
    spec = loaded.spec
    if isinstance(spec, SceneSpec):
        return VisibleScene(pictured(loaded), spec.viewpoint or "")
    if isinstance(spec, AssetSpec):
        return VisibleScene(pictured_asset(loaded), azimuth_deg=FRONT_DEG)
    if isinstance(spec, TaskSpec):
        scene = loaded.used(spec.scene)
        if scene is None or not isinstance(scene.spec, SceneSpec):
            return None
        return VisibleScene(pictured(scene, [spec.start]), scene.spec.viewpoint or "")
    twin = getattr(spec, "twin", None)
    used = loaded.used(twin) if isinstance(twin, str) else None
    return _visible(used) if used is not None and isinstance(used.spec, SceneSpec | TaskSpec) else None


def draft_of(analysis: Analysis) -> DraftScene | None:
    """Return the lowered scene that the names of a document refer to, or None if it cannot be lowered."""
    if analysis.draft is not None:
        return analysis.draft
    twin = getattr(analysis.loaded.spec, "twin", None)
    used = analysis.loaded.used(twin) if isinstance(twin, str) else None
    try:
        return drafted_start(used) if used is not None and isinstance(used.spec, SceneSpec | TaskSpec) else None
    except SpecError:
        return None


def scene_picture(visible: VisibleScene, view: ViewRequest, checkpoint: Checkpoint = lambda: None) -> ScenePicture:
    """Render a scene from its viewpoint, or in a three-quarter view, or from where the request says."""
    scene = visible.scene
    center, radius = framing([scene])
    checkpoint()
    camera = next((camera for camera in scene.cameras if camera.name == visible.viewpoint), None)
    orbit = default_orbit(radius)
    if visible.azimuth_deg is not None:
        orbit = replace(orbit, azimuth_deg=visible.azimuth_deg)
    moved = view.azimuth_deg is not None or view.elevation_deg is not None or view.distance is not None
    if camera is not None:
        orbit = Orbit.of(camera.X_WC.p - center)
    if camera is None or moved:
        orbit = Orbit(
            orbit.azimuth_deg if view.azimuth_deg is None else view.azimuth_deg,
            orbit.elevation_deg if view.elevation_deg is None else view.elevation_deg,
            orbit.distance if view.distance is None else view.distance,
        )
        camera = orbit_camera(center, orbit, view.width, view.height)
    else:
        camera = shrunk(camera, view.width, view.height)
    image = quick_image(scene, camera, checkpoint=checkpoint)
    checkpoint()
    return ScenePicture(png_bytes(image, fast=True), camera.width, camera.height, orbit)


def png_bytes(image: NDArray[np.uint8], fast: bool = False) -> bytes:
    """Return an image as PNG. A ``fast`` one is larger by half, and takes a tenth of the time."""
    from PIL import Image

    out = io.BytesIO()
    Image.fromarray(image).save(out, format="PNG", **({"compress_level": 1} if fast else {"optimize": True}))
    return out.getvalue()


@dataclass
class ObjectPictures:
    """Small pictures of objects, which are kept by the content of what they show."""

    _kept: OrderedDict[str, str] = field(default_factory=OrderedDict)
    _lock: Lock = field(default_factory=Lock)

    def uri(self, item: SceneObject) -> str:
        """Return the picture of an object as a data URI, or an empty string if it is empty or too large."""
        key = _content(item)
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
                return self._kept[key]
        png = object_picture(item)
        uri = f"data:image/png;base64,{base64.b64encode(png).decode()}" if 0 < len(png) <= MAX_OBJECT_BYTES else ""
        with self._lock:
            self._kept[key] = uri
            while len(self._kept) > MOST_KEPT:
                self._kept.popitem(last=False)
        return uri


def _content(item: SceneObject) -> str:
    """Return a hash of what a picture of an object shows, which does not depend on its position."""
    total = hashlib.sha256(item.X_WO.q.tobytes())
    poses = link_poses(item)
    for link in item.links:
        for visual in link.visuals or link.colliders:
            X_OG = poses[link.name] @ visual.X_LG
            rgba = getattr(visual, "rgba", None)
            total.update(pickle.dumps((X_OG.p, X_OG.q, rgba, visual.geometry), protocol=5))
    return total.hexdigest()


def object_picture(item: SceneObject) -> bytes:
    """Return a three-quarter view of an object alone, as PNG bytes, or no bytes if it has no visuals."""
    if not any(link.visuals for link in item.links):
        return b""
    alone = Scene(item.name, np.zeros(3), (replace(item, X_WO=Pose.of(q=item.X_WO.q), variants=()),))
    width, height = OBJECT_SIZE
    camera: Camera = overview([alone], 2 * width, 2 * height, least=0.0)
    image = quick_image(alone, camera).astype(np.uint16)
    small = (image[::2, ::2] + image[1::2, ::2] + image[::2, 1::2] + image[1::2, 1::2] + 2) // 4
    return png_bytes(small.astype(np.uint8))
