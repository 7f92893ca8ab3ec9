"""The gizmo of what is selected: it previews a move while it is dragged, and becomes an act on release."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from simfoundry.geometry.frames import Pose
from simfoundry.geometry.similarity import Similarity
from simfoundry.scene.object_shapes import world_bounds
from simfoundry.studio.acts.act import Act
from simfoundry.studio.acts.background import AlignBackground, background_similarity
from simfoundry.studio.acts.cameras import MoveCamera
from simfoundry.studio.view.nodes import SELECTION_RGB, Nodes, ViewNode, box_lines

if TYPE_CHECKING:
    from simfoundry.studio.view.window import StudioWindow

# Least length [m] of the gizmo's arrows, and their length relative to the object, beyond which they protrude.
LEAST_M, SHARE = 0.08, 0.75

# Length [m] of the arrows of a camera.
CAMERA_M = 0.15

# Length [m] of the arrows of the background, which is as large as a room, but is aligned at the objects.
BACKGROUND_M = 0.4

# Distance [m] of the lines around the selected object from it, so that they are not hidden by its surface.
MARGIN_M = 0.002


@dataclass(frozen=True)
class GizmoTarget:
    """Target of a gizmo: the node that it previews, its pose in the world, and the act for a new pose."""

    node: str
    X_WT: Pose
    size: float
    act: Callable[[Pose], Act]


class SelectionGizmo:
    """The arrows and rings around what is selected."""

    def __init__(self, window: StudioWindow) -> None:
        self._window = window
        self._handle: Any = None
        self._shown: tuple[str, float] = ("", 0.0)
        self.dragged_by: int | None = None

    @property
    def size(self) -> float:
        """The length of the arrows [m]."""
        return self._shown[1]

    @property
    def dragged_node(self) -> str:
        """The name of the node that is being dragged, or an empty string."""
        return self._shown[0] if self.dragged_by is not None else ""

    def refresh(self) -> None:
        """Put the gizmo where the selection is, or remove it. Nothing happens while it is dragged."""
        target = self._target() if self._window.is_editable and not self._window.is_picking else None
        if self.dragged_by is not None and target is not None and target.node == self._shown[0]:
            return
        self.dragged_by = None
        if target is None or self._shown != (target.node, target.size):
            self._remove()
        if target is not None:
            if self._handle is None:
                self._add(target)
            self._handle.position, self._handle.wxyz = target.X_WT.p, target.X_WT.q

    def nodes(self) -> Nodes:
        """Return the frame around the selected object."""
        scene, name = self._window.shown_scene, self._window.selected_object
        if scene is None or name not in scene.objects:
            return {}
        low, high = world_bounds(scene.objects[name], Pose.of())
        return {f"/objects/{name}/selection": ViewNode(box_lines(low - MARGIN_M, high + MARGIN_M, SELECTION_RGB))}

    def cancel(self, client_id: int) -> None:
        """Give up a drag whose browser is gone; what it moved returns to where the text says it is."""
        if self.dragged_by == client_id:
            self.dragged_by = None
            self._window.request_refresh()

    def _target(self) -> GizmoTarget | None:
        window, scene = self._window, self._window.session.scene
        section, _, name = window.selection.partition(".")
        if scene is None:
            return None
        if section == "objects" and name in scene.objects:
            X_WO = scene.objects[name].X_WO
            low, high = world_bounds(scene.objects[name], X_WO)
            size = round(max(LEAST_M, SHARE * float(np.linalg.norm(high - low))), 2)

            return GizmoTarget(f"/objects/{name}", X_WO, size, lambda X_WO: window.move_act(name, X_WO))
        if section == "cameras" and name in scene.draft.cameras:
            X_WC = scene.draft.cameras[name].X_WC
            return GizmoTarget(f"/cameras/{name}", X_WC, CAMERA_M, lambda X_WC: MoveCamera(name, X_WC))
        if section == "background" and scene.spec.background is not None:
            S_WF = background_similarity(scene)
            return GizmoTarget(
                "/background", S_WF.X_AB, BACKGROUND_M, lambda X_WB: AlignBackground(Similarity(X_WB, S_WF.scale))
            )
        return None

    def _add(self, target: GizmoTarget) -> None:
        self._shown = target.node, target.size
        self._handle = self._window.server.scene.add_transform_controls(
            "/gizmo", scale=target.size, depth_test=False, line_width=3.0
        )

        async def on_update(event: Any) -> None:  # on the event loop, which keeps the order of events
            self._drag(target, event.phase, event.client_id, Pose.of(event.target.position, event.target.wxyz))

        self._handle.on_update(on_update)

    def _drag(self, target: GizmoTarget, phase: str, client_id: int | None, X_WT: Pose) -> None:
        if target.node != self._shown[0] or client_id not in self._window.server.get_clients():
            return  # events may still be waiting when their browser is gone
        if phase == "end":
            self.dragged_by = None
            self._window.submit(target.act(X_WT))
            return
        self.dragged_by = client_id
        self._window.canvas.move(target.node, X_WT)
        for preview in self._window.previews:
            preview(target.node, X_WT)

    def _remove(self) -> None:
        if self._handle is not None:
            self._handle.remove()
            self._handle = None
        self._shown = "", 0.0
