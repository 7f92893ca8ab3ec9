"""The capture behind the scene: its cloud with size, density and colors, and its picture behind the objects."""

from __future__ import annotations

from dataclasses import replace
from itertools import count
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from simfoundry.capture.outputs.overlay import CaptureOverlay, object_surface
from simfoundry.capture.shapes.register_mesh import Surface
from simfoundry.geometry.frames import Array, Pose
from simfoundry.render.montage import label_color
from simfoundry.scene.model import SceneObject
from simfoundry.studio.view.contents import CloudContent, FrameContent, PictureContent
from simfoundry.studio.view.nodes import Nodes, ViewNode, link_surface
from simfoundry.studio.view.panels.panel import Panel, set_value

if TYPE_CHECKING:
    from simfoundry.studio.view.window import StudioWindow

# Colors of the cloud that can be chosen.
PHOTO, OBJECTS, SELECTED, ERRORS = "photo", "objects", "selected object", "fit error"

# Colors (sRGB, 0 to 255) of the selected object's points, and of those that belong to no object or to another one.
MARKED_RGB, OTHER_RGB = (255, 90, 0), (150, 150, 150)

# Colors (sRGB, 0 to 255) of points on the surface of their object, half as far away as the largest distance [m], and at
# least so far. Depth cameras are off by a few millimeters at 1 m, and reconstructions by about two.
FIT_RGB, LARGEST_M = np.array([(0, 160, 60), (250, 200, 0), (220, 0, 30)]), 0.01

# Name of the node of the cloud, and the word in its paint while the object of its colors is dragged.
CLOUD, DRAGGED = "/capture/cloud", " while dragged "

# Density [%] and size [mm] of the points at first: light enough for a browser on a laptop, and without gaps at 1 m.
DENSITY, SIZE_MM = 50, 2.0

# Fraction of the measured depths in front of the picture, and its distance from the farthest of them.
FARTHEST_SHARE, BEHIND = 0.99, 1.05


class CapturePanel(Panel):
    """Switches for the cloud and the picture."""

    edits = False

    def __init__(self, window: StudioWindow) -> None:
        super().__init__(window)
        gui, self._paints = window.gui, count()
        self._state = gui.add_markdown("")
        self._folder = gui.add_folder("Cloud and picture", visible=False)
        with self._folder:
            self.cloud = gui.add_checkbox("Cloud", True)
            self.size = gui.add_slider("Point size [mm]", min=0.5, max=10.0, step=0.5, initial_value=SIZE_MM)
            self.density = gui.add_slider("Density [%]", min=1, max=100, step=1, initial_value=DENSITY)
            self.colors = gui.add_dropdown("Colors", (PHOTO, OBJECTS, SELECTED, ERRORS), initial_value=PHOTO)
            self.picture = gui.add_checkbox("Picture", False, hint="The picture, behind what it shows.")
            self._look = gui.add_button("Look through the camera")
        for handle in (self.cloud, self.size, self.density, self.colors, self.picture):
            handle.on_update(lambda _: window.request_refresh())
        self._look.on_click(self._look_through)

    def refresh(self) -> None:
        """Show which capture it is, or why there is none."""
        link = self.window.capture
        if link.source is not None:
            shown = f"Capture **{self.session.shown_path(link.source.document)}**, frame `{link.source.frame}`."
        elif link.problem:
            shown = f"The capture cannot be shown: {link.problem}."
        else:
            shown = "Loading the capture …" if link.is_named else "The scene was not reconstructed from a capture."
        set_value(self._state, shown)
        visible = link.overlay is not None
        if self._folder.visible != visible:
            self._folder.visible = visible

    def nodes(self) -> Nodes:
        """Return the cloud and the picture."""
        overlay = self.window.capture.overlay
        if overlay is None:
            return {}
        nodes: Nodes = {}
        if self.cloud.value:
            segment = self.window.capture.segment(self.window.selected_object)
            nodes[CLOUD] = ViewNode(self._cloud(overlay, segment))
        if self.picture.value:
            nodes["/capture/picture"] = picture_node(overlay)
        return {"/capture": ViewNode(FrameContent()), **nodes} if nodes else {}

    def _cloud(self, overlay: CaptureOverlay, segment: int) -> CloudContent:
        share, colors = float(self.density.value) / 100, str(self.colors.value)
        key, size = f"{id(overlay)} {share}", float(self.size.value) / 1000
        paint = f"{colors} {segment if colors == SELECTED else 0}" + (self._poses() if colors == ERRORS else "")
        shown = self._shown
        if shown is not None and (shown.key, shown.paint) == (key, paint):
            return replace(shown, size=size)
        points, photo, numbers = overlay.cloud(share)
        if colors == ERRORS:
            rgb = error_colors(overlay.errors(self._surfaces(), share))
        else:
            rgb = cloud_colors(colors, photo, numbers, segment)
        return CloudContent(key, paint, points.astype(np.float32), rgb, size)

    @property
    def _shown(self) -> CloudContent | None:
        node = self.window.canvas.nodes.get(CLOUD)
        return node.content if node is not None and isinstance(node.content, CloudContent) else None

    def show_errors(self, name: str, X_WO: Pose) -> None:
        """Color the points of an object by its fit error at a pose to which it is being dragged."""
        with self.session.lock:
            overlay, shown = self.window.capture.overlay, self._shown
            scene, segment = self.session.scene, self.window.capture.segment(name)
            item = scene.objects.get(name) if scene is not None else None
        if overlay is None or shown is None or item is None or not segment or self.colors.value != ERRORS:
            return
        share = float(self.density.value) / 100
        vertices, faces = object_surface(item)
        errors = overlay.errors({segment: (X_WO.apply(vertices), faces)}, share)
        with self.session.lock:
            if self._shown != shown or self.window.gizmo.dragged_node != f"/objects/{name}":
                return  # something else is shown by now, such as the object where it was let go
            rgb = np.where(np.isnan(errors)[:, None], shown.rgb, error_colors(errors))
            paint = f"{shown.paint.partition(DRAGGED)[0]}{DRAGGED}{next(self._paints)}"
            self.window.canvas.paint(CLOUD, replace(shown, paint=paint, rgb=rgb))

    def _surfaces(self) -> dict[int, Surface]:
        """Return the surfaces of all objects that the capture shows, in the world."""
        found = {}
        for item in self._objects():
            vertices, faces = object_surface(item)
            found[self.window.capture.segment(item.name)] = item.X_WO.apply(vertices), faces
        return found

    def _objects(self) -> list[SceneObject]:
        """Return the objects that the capture shows."""
        scene = self.session.scene
        return [o for o in scene.objects.values() if self.window.capture.segment(o.name)] if scene is not None else []

    def _poses(self) -> str:
        """Return what identifies the poses of the objects and their shapes."""
        found = []
        for item in self._objects():
            surfaces = [surface.key for link in item.links if (surface := link_surface(link)) is not None]
            found.append((surfaces, item.X_WO.p.tolist(), item.X_WO.q.tolist()))
        return repr(found)

    def _look_through(self, event: Any) -> None:
        overlay = self.window.capture.overlay
        if event.client is not None and overlay is not None:
            self.window.options = replace(self.window.options, cameras=False)  # the frustum would be in front of it
            self.window.request_refresh()
            camera, height = event.client.camera, overlay.frame.depth.shape[0]
            camera.position, camera.wxyz = overlay.X_WC.p, overlay.X_WC.q
            camera.fov = 2 * float(np.arctan2(height / 2, overlay.frame.K[1, 1]))


def cloud_colors(colors: str, photo: NDArray[np.uint8], numbers: NDArray[np.int32], segment: int) -> NDArray[np.uint8]:
    """Return the colors of points, shape (n, 3), from those in the photo and the numbers of their objects."""
    if colors == PHOTO:
        return photo
    out = np.empty_like(photo)
    out[:] = OTHER_RGB
    for number in np.unique(numbers[numbers > 0]).tolist():
        if colors == OBJECTS or number == segment:
            out[numbers == number] = label_color(number) if colors == OBJECTS else MARKED_RGB
    return out


def error_colors(errors: Array) -> NDArray[np.uint8]:
    """Return the colors of points, shape (n, 3), from their distances [m] from their objects, shape (n,).

    They go from green by way of yellow to red, and are gray for points that belong to no object (NaN).
    """
    share = np.clip(np.where(np.isfinite(errors), errors, LARGEST_M) / LARGEST_M, 0.0, 1.0)
    rgb = np.stack([np.interp(share, (0.0, 0.5, 1.0), FIT_RGB[:, k]) for k in range(3)], axis=-1)
    return np.where(np.isnan(errors)[:, None], OTHER_RGB, rgb).astype(np.uint8)


def picture_node(overlay: CaptureOverlay) -> ViewNode:
    """Return the picture on a rectangle behind all that it shows, which covers its camera's view exactly."""
    frame = overlay.frame
    height, width = frame.depth.shape
    distance = float(np.nanquantile(frame.depth, FARTHEST_SHARE)) * BEHIND
    fx, fy, cx, cy = frame.K[0, 0], frame.K[1, 1], frame.K[0, 2], frame.K[1, 2]
    middle = (((width - 1) / 2 - cx) / fx * distance, ((height - 1) / 2 - cy) / fy * distance, distance)
    content = PictureContent(str(id(overlay)), frame.color, width / fx * distance, height / fy * distance)
    return ViewNode(content, overlay.X_WC @ Pose.of(middle))
