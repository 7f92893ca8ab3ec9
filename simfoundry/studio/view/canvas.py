"""Send nodes to the browser: only those that were added, removed, moved or changed."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from simfoundry.geometry.frames import Array, Pose, rotations
from simfoundry.render.shading import encode_srgb
from simfoundry.render.views import default_orbit, framing
from simfoundry.scene.model import LightType
from simfoundry.scene.object_shapes import world_bounds
from simfoundry.splats.harmonics import SH0
from simfoundry.studio.view.contents import (
    CloudContent,
    FrameContent,
    FrustumContent,
    LabelContent,
    LightContent,
    LinesContent,
    PictureContent,
    SplatContent,
    SurfaceContent,
)
from simfoundry.studio.view.nodes import CAMERA_RGB, FRUSTUM_M, ViewNode

if TYPE_CHECKING:
    from viser import SceneApi, ViserServer

    from simfoundry.scene.model import Scene
    from simfoundry.splats.gaussians import GaussianSplat

# Intensity of a light in the browser that fully lights a white surface, which reflects 1 / pi of what reaches it.
FULLY_LIT = math.pi

# Distance [m] of the grid below the lowest object, so that neither hides the other.
GRID_BELOW_M = 0.001

# Called with what a click selects, such as ``objects.mug``.
Select = Callable[[str], None]

# Called with the node that was clicked on, and the origin [m] and the direction of the line of sight in the world.
Poke = Callable[[str, tuple[float, ...], tuple[float, ...]], None]


class Canvas:
    """The scene in the browser, which follows the nodes that it is given.

    Attributes:
        sent: The number of messages about nodes that were sent so far, for measurements and tests.
    """

    def __init__(
        self, scene: SceneApi, select: Select = lambda name: None, poke: Poke = lambda node, origin, direction: None
    ) -> None:
        self._scene, self._select, self._poke = scene, select, poke
        self._nodes: dict[str, ViewNode] = {}
        self._handles: dict[str, Any] = {}
        self._lighting: tuple[bool, bool] | None = None
        self.sent = 0

    @property
    def nodes(self) -> Mapping[str, ViewNode]:
        """The nodes that are shown."""
        return dict(self._nodes)

    def show(self, nodes: Mapping[str, ViewNode]) -> None:
        """Show exactly these nodes. A node's name is a path; its parents are shown as well."""
        for name in [name for name in self._nodes if name not in nodes]:
            self._remove(name)
        for name in sorted(nodes, key=lambda name: name.count("/")):
            self.put(name, nodes[name])

    def light(self, is_even: bool, casts_shadows: bool) -> None:
        """Light the scene evenly, as a room does, or only by the lights among the nodes."""
        if self._lighting != (is_even, casts_shadows):
            self._scene.configure_default_lights(is_even, cast_shadow=casts_shadows)
            if is_even != (self._lighting is None or self._lighting[0]):
                self._scene.configure_environment_map("city" if is_even else None)
            self._lighting = is_even, casts_shadows
            self.sent += 1

    def put(self, name: str, node: ViewNode) -> None:
        """Show one node, in place of the present one with this name."""
        old = self._nodes.get(name)
        if old is not None and isinstance(node.content, CloudContent) and self.paint(name, node.content):
            old = self._nodes[name]
        if old is None or old.content != node.content or old.selects != node.selects:
            if old is not None:
                below = {n: each for n, each in self._nodes.items() if n.startswith(f"{name}/")}
                self._remove(name)
            else:
                below = {}
            handle = self._add(name, node)
            self._handles[name], self._nodes[name] = handle, node
            self.sent += 1
            for each in sorted(below, key=lambda n: n.count("/")):
                self.put(each, below[each])
            return
        handle = self._handles[name]
        if not _is_same(old.X_PN, node.X_PN):
            self._pose(handle, node.X_PN)
        if old.is_visible != node.is_visible:
            handle.visible = node.is_visible
            self.sent += 1
        self._nodes[name] = node

    def paint(self, name: str, content: CloudContent) -> bool:
        """Give the points of a cloud other colors and another size, and return False if other points are shown."""
        node = self._nodes.get(name)
        shown = node.content if node is not None else None
        if node is None or not isinstance(shown, CloudContent) or shown.key != content.key:
            return False
        handle = self._handles[name]
        if shown.paint != content.paint:
            handle.colors = content.rgb
            self.sent += 1
        if shown.size != content.size:
            handle.point_size = content.size
            self.sent += 1
        self._nodes[name] = replace(node, content=content)
        return True

    def move(self, name: str, X_PN: Pose) -> None:
        """Move a node for the time being, such as while it is dragged."""
        if name in self._handles:
            self._pose(self._handles[name], X_PN)
            old = self._nodes[name]
            self._nodes[name] = ViewNode(old.content, X_PN, old.selects, old.is_visible)

    def _pose(self, handle: Any, X_PN: Pose) -> None:
        handle.position, handle.wxyz = X_PN.p, X_PN.q
        self.sent += 1

    def _remove(self, name: str) -> None:
        for each in [n for n in self._nodes if n == name or n.startswith(f"{name}/")]:
            del self._nodes[each]
            del self._handles[each]
        self._scene.remove_by_name(name)
        self.sent += 1

    def _add(self, name: str, node: ViewNode) -> Any:
        scene = self._scene
        place: dict[str, Any] = {"position": node.X_PN.p, "wxyz": node.X_PN.q, "visible": node.is_visible}
        handle: Any
        match node.content:
            case SurfaceContent() as content:
                handle = scene.add_glb(name, content.glb, **place)
            case FrameContent(axes):
                place |= {"axes_length": axes or 0.1, "axes_radius": (axes or 0.1) / 40}
                return scene.add_frame(name, show_axes=axes > 0, **place)
            case LinesContent(points, rgb, thickness):
                lines = np.array(points, dtype=np.float32).reshape(-1, 2, 3)
                return scene.add_line_segments(name, lines, rgb, thickness=thickness, thickness_units="screen", **place)
            case FrustumContent(fov, aspect, image):
                picture = _decoded(image) if image else None
                handle = scene.add_camera_frustum(
                    name, fov, aspect, scale=FRUSTUM_M, thickness=1.5, thickness_units="screen", color=CAMERA_RGB,
                    image=picture, **place,
                )  # fmt: skip
            case LabelContent(text):
                return scene.add_label(name, text, **place)
            case CloudContent() as cloud:
                colors: Any = cloud.rgb
                return scene.add_point_cloud(name, cloud.points, colors, point_size=cloud.size, **place)
            case PictureContent() as shown:
                return scene.add_image(name, shown.picture, shown.width, shown.height, **place)
            case LightContent() as light:
                return _add_light(scene, name, light, place)
            case SplatContent(gaussians):
                return scene.add_gaussian_splats(name, *_splat_arrays(gaussians), **place)
        if node.selects:
            selects = node.selects
            handle.on_click(lambda event: self._click(name, selects, event))
        return handle

    def _click(self, node: str, selects: str, event: Any) -> None:
        self._select(selects)
        self._poke(node, event.ray_origin, event.ray_direction)


def _add_light(scene: SceneApi, name: str, light: LightContent, place: dict[str, Any]) -> Any:
    brightest = max(*light.rgb, *light.below, 1e-6)
    above, below = (_color(np.array(rgb) / brightest) for rgb in (light.rgb, light.below))
    intensity = FULLY_LIT * brightest
    match light.type:
        case LightType.DISTANT:
            shadow = light.casts_shadows
            return scene.add_light_directional(name, color=above, intensity=intensity, cast_shadow=shadow, **place)
        case LightType.POINT:
            return scene.add_light_point(name, color=above, intensity=intensity, decay=0.0, **place)
        case LightType.DOME:
            return scene.add_light_hemisphere(name, sky_color=above, ground_color=below, intensity=intensity, **place)


def _color(linear: Array) -> tuple[int, int, int]:
    r, g, b = encode_srgb(linear).tolist()
    return r, g, b


def prepare_view(server: ViserServer, scene: Scene | None, has_robot: bool = False) -> None:
    """Let z point up, draw a grid of 10 cm below all objects, and start with a view of all movable objects of a scene.

    A robot is looked at from its front, because it would hide the objects from its back.
    """
    server.scene.set_up_direction("+z")
    bounds = [] if scene is None else [world_bounds(item, item.X_WO) for item in scene.objects]
    ground = min((float(low[2]) for low, _ in bounds), default=0.0)  # a table top at z = 0 would be covered by the grid
    place = (0.0, 0.0, min(ground, 0.0) - GRID_BELOW_M)
    server.scene.add_grid(
        "/grid", infinite_grid=True, cell_size=0.1, section_size=1.0, fade_distance=10.0, position=place
    )
    if scene is not None:
        center, radius = framing([scene])
        orbit = default_orbit(radius)
        if has_robot:
            orbit = replace(orbit, azimuth_deg=180.0 - orbit.azimuth_deg)
        server.initial_camera.position = tuple(orbit.eye(center).tolist())
        server.initial_camera.look_at = tuple(center.tolist())


def _is_same(a: Pose, b: Pose) -> bool:
    return a is b or (a.p.tolist() == b.p.tolist() and a.q.tolist() == b.q.tolist())


def _splat_arrays(gaussians: GaussianSplat) -> tuple[Any, Any, Any, Any]:
    """Return the centers (n, 3), covariances (n, 3, 3), colors (n, 3) and opacities (n, 1) of a splat."""
    axes = rotations(gaussians.rotations.astype(np.float64)) * gaussians.scales[:, None, :]
    colors = np.clip(gaussians.harmonics[:, 0] * SH0 + 0.5, 0.0, 1.0)
    return gaussians.positions, axes @ axes.transpose(0, 2, 1), colors, gaussians.opacities[:, None]


def _decoded(png: bytes) -> np.ndarray[Any, Any]:
    import io

    from PIL import Image

    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB"))
