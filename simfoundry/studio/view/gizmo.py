"""The gizmo of the selected object: it previews a move while it is dragged, and becomes an act on release."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from simfoundry.geometry.frames import Pose
from simfoundry.scene.object_shapes import world_bounds
from simfoundry.studio.acts.move import MoveObject
from simfoundry.studio.view.nodes import SELECTION_RGB, Nodes, ViewNode, box_lines

if TYPE_CHECKING:
    from simfoundry.studio.view.window import StudioWindow

# Least length [m] of the gizmo's arrows, and their length relative to the object, beyond which they protrude.
LEAST_M, SHARE = 0.08, 0.75


class ObjectGizmo:
    """The arrows and rings around the selected object."""

    def __init__(self, window: StudioWindow) -> None:
        self._window = window
        self._handle: Any = None
        self._name = ""
        self._size = 0.0
        self.dragged_by: int | None = None

    def refresh(self) -> None:
        """Put the gizmo where the selected object is, or remove it. Nothing happens while it is dragged."""
        scene, name = self._window.session.scene, self._window.selected_object
        shown = scene is not None and name in scene.objects and self._window.is_editable
        if self.dragged_by is not None and shown and name == self._name:
            return
        self.dragged_by = None
        if not shown or scene is None:
            self._remove()
            return
        item = scene.objects[name]
        low, high = world_bounds(item, item.X_WO)
        size = round(max(LEAST_M, SHARE * float(np.linalg.norm(high - low))), 2)
        if self._handle is None or name != self._name or size != self._size:
            self._remove()
            self._add(name, size, item.X_WO)
        self._handle.position, self._handle.wxyz = item.X_WO.p, item.X_WO.q

    def nodes(self) -> Nodes:
        """Return the frame around the selected object."""
        scene, name = self._window.session.scene, self._window.selected_object
        if scene is None or name not in scene.objects:
            return {}
        item = scene.objects[name]
        low, high = world_bounds(item, Pose.of())
        return {f"/objects/{name}/selection": ViewNode(box_lines(low - 0.002, high + 0.002, SELECTION_RGB))}

    def cancel(self, client_id: int) -> None:
        """Give up a drag whose browser is gone; the object returns to where the text says it is."""
        if self.dragged_by == client_id:
            self.dragged_by = None
            self._window.request_refresh()

    def _add(self, name: str, size: float, X_WO: Pose) -> None:
        self._name, self._size = name, size
        self._handle = self._window.server.scene.add_transform_controls(
            "/gizmo", scale=size, position=X_WO.p, wxyz=X_WO.q, depth_test=False, line_width=3.0
        )

        async def on_update(event: Any) -> None:  # on the event loop, which keeps the order of events
            self._drag(name, event.phase, event.client_id, Pose.of(event.target.position, event.target.wxyz))

        self._handle.on_update(on_update)

    def _drag(self, name: str, phase: str, client_id: int | None, X_WO: Pose) -> None:
        if name != self._name or client_id is None:
            return
        if phase == "end":
            self.dragged_by = None
            window = self._window
            window.submit(MoveObject(name, X_WO, drop=window.drops, snap=window.snap))
            return
        self.dragged_by = client_id
        self._window.canvas.move(f"/objects/{name}", X_WO)

    def _remove(self) -> None:
        if self._handle is not None:
            self._handle.remove()
            self._handle = None
