"""The regions in which objects of a task start: rectangles that are dragged by their middle or by a corner."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from simfoundry.spec.models.task import ResetRegion
from simfoundry.studio.acts.regions import RemoveRegion, SetRegion
from simfoundry.studio.view.contents import LinesContent
from simfoundry.studio.view.nodes import REGION_RGB, SELECTION_RGB, Nodes, ViewNode
from simfoundry.studio.view.panels.panel import Panel, by_person, set_value

if TYPE_CHECKING:
    from simfoundry.studio.view.window import StudioWindow

# Height [m] of a region above what the object stands on, so that its lines are not hidden.
LIFT_M = 0.003

# Length [m] of the arrows that drag a region, and the least extent [m] that a corner can give it.
ARROW_M, LEAST_M = 0.08, 0.005

# Largest rotation [deg] to each side of an object that starts in a region, which is any rotation.
FULL_TURN = 180


class RegionPanel(Panel):
    """Add, drag and remove the region of the selected object."""

    def __init__(self, window: StudioWindow) -> None:
        super().__init__(window)
        self._folder = window.gui.add_folder("Start region", visible=False)
        with self._folder:
            self._edit = window.gui.add_checkbox("Drag region", False, hint="Drag it by its middle or by a corner.")
            self._spin = window.gui.add_slider("Turn by up to [°]", 0, FULL_TURN, 5, 0)
            window.gui.add_button("Remove region").on_click(lambda _: self._remove())
        self._edit.on_update(by_person(lambda _: window.request_refresh()))
        self._spin.on_update(by_person(lambda event: self._turn(float(event.target.value))))
        self._handles: dict[str, Any] = {}
        self._dragged = ""

    def refresh(self) -> None:
        """Show the controls of the selected object's region."""
        scene, name = self.session.scene, self.window.selected_object
        shown = scene is not None and scene.task is not None and name in scene.objects
        if self._folder.visible != shown:
            self._folder.visible = shown
        self._place_handles(self._region(name) if shown and self._edit.value else None, name)

    def _region(self, name: str) -> ResetRegion | None:
        """Return the region of an object, which is created when it is first edited."""
        scene = self.session.scene
        assert scene is not None and scene.task is not None
        found = scene.task.reset.objects.get(name)
        if found is None and self._edit.value:
            self.window.submit(SetRegion(name))
        return found

    def nodes(self) -> Nodes:
        """Return the outlines of all regions."""
        scene = self.session.scene
        if scene is None or scene.task is None:
            return {}
        nodes: Nodes = {}
        for name, region in scene.task.reset.objects.items():
            if name in scene.draft.bounds:
                rgb = SELECTION_RGB if name == self.window.selected_object else REGION_RGB
                z = float(scene.draft.bounds[name][0][2]) + LIFT_M
                nodes[f"/regions/{name}"] = ViewNode(_outline(region, z, rgb), selects=f"objects.{name}")
        return nodes

    def _place_handles(self, region: ResetRegion | None, name: str) -> None:
        if self._dragged:
            return
        scene = self.session.scene
        if region is None or scene is None or name not in scene.draft.bounds:
            for handle in self._handles.values():
                handle.remove()
            self._handles = {}
            return
        z = float(scene.draft.bounds[name][0][2]) + LIFT_M
        ends = np.array([region.x, region.y])
        for which, p in (("middle", ends.mean(axis=1)), ("corner", ends[:, 1])):
            if which not in self._handles:
                handle = self.window.server.scene.add_transform_controls(
                    f"/region_{which}", scale=ARROW_M, active_axes=(True, True, False), disable_rotations=True,
                    depth_test=False,
                )  # fmt: skip

                async def on_update(event: Any, which: str = which) -> None:
                    self._drag(which, event.phase, event.client_id, np.array(event.target.position[:2]))

                handle.on_update(on_update)
                self._handles[which] = handle
            self._handles[which].position = (*p, z)

    def _drag(self, which: str, phase: str, client_id: int | None, p: np.ndarray[Any, Any]) -> None:
        scene, name = self.session.scene, self.window.selected_object
        if client_id is None or scene is None or scene.task is None or name not in scene.task.reset.objects:
            return
        region = scene.task.reset.objects[name]
        low, high = np.array([region.x, region.y]).T
        if which == "middle":
            low, high = p - (high - low) / 2, p + (high - low) / 2
        else:
            high = np.maximum(p, low + LEAST_M)
        self._dragged = "" if phase == "end" else which
        (x0, y0), (x1, y1) = low.tolist(), high.tolist()
        if phase == "end":
            self.window.submit(SetRegion(name, (x0, x1), (y0, y1)))
        else:
            z = float(scene.draft.bounds[name][0][2]) + LIFT_M
            preview = ResetRegion(x=(x0, x1), y=(y0, y1))
            self.window.canvas.put(f"/regions/{name}", ViewNode(_outline(preview, z, SELECTION_RGB)))

    def _turn(self, degrees: float) -> None:
        name = self.window.selected_object
        self.window.submit_latest(SetRegion(name, yaw_deg=(-degrees, degrees)), f"region {name}")

    def _remove(self) -> None:
        set_value(self._edit, False)
        self.window.submit(RemoveRegion(self.window.selected_object))


def _outline(region: ResetRegion, z: float, rgb: tuple[int, int, int]) -> LinesContent:
    """Return the rectangle of a region at a height [m]."""
    (x0, x1), (y0, y1) = region.x, region.y
    corners = [(x0, y0, z), (x1, y0, z), (x1, y1, z), (x0, y1, z)]
    return LinesContent(tuple((corners[k - 1], corners[k]) for k in range(4)), rgb, 3.0)
