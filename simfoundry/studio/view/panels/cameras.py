"""Cameras: add one where the person looks from, look through one, and select one to drag it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from simfoundry.geometry.frames import Pose
from simfoundry.studio.acts.cameras import AddCamera
from simfoundry.studio.view.panels.panel import Panel, by_person, set_value

if TYPE_CHECKING:
    from simfoundry.studio.view.window import StudioWindow

NOTHING = "(none)"


class CameraPanel(Panel):
    """Selection of a camera, the view through it, and a new camera at the present view."""

    def __init__(self, window: StudioWindow) -> None:
        super().__init__(window)
        gui = window.gui
        with gui.add_folder("Cameras", expand_by_default=False):
            self._select = gui.add_dropdown("Camera", (NOTHING,), initial_value=NOTHING)
            gui.add_button("Look through").on_click(self._look)
            self._name = gui.add_text("Camera name", "")
            gui.add_button("Add camera here").on_click(self._add)
        self._select.on_update(by_person(lambda event: self._choose(event.target.value)))

    def refresh(self) -> None:
        """Offer the cameras of the scene."""
        scene = self.session.scene
        names = (NOTHING, *(scene.draft.cameras if scene is not None else ()))
        if self._select.options != names:
            self._select.options = names
        section, _, name = self.window.selection.partition(".")
        set_value(self._select, name if section == "cameras" and name in names else NOTHING)

    def _choose(self, name: str) -> None:
        self.window.select("" if name == NOTHING else f"cameras.{name}")

    def _look(self, event: Any) -> None:
        """Move the camera of the person's browser to that of the scene."""
        scene, name = self.session.scene, self._select.value
        if scene is None or name not in scene.draft.cameras or event.client is None:
            return
        camera, view = scene.draft.cameras[name], event.client.camera
        view.position, view.wxyz = camera.X_WC.p, camera.X_WC.q
        view.fov = 2 * math.atan2(camera.height / 2, camera.fy)

    def _add(self, event: Any) -> None:
        """Add a camera where the person looks from."""
        if event.client is None:
            return
        view = event.client.camera
        taken = self.session.scene.spec.cameras if self.session.scene is not None else {}
        name = self._name.value.strip() or next(n for k in range(1, 1000) if (n := f"view_{k}") not in taken)
        x, y, z = (float(v) for v in np.asarray(view.look_at))
        act = AddCamera(name, Pose.of(view.position, view.wxyz), (x, y, z), math.degrees(view.fov))
        self.window.submit(act, then=lambda: self.window.select(f"cameras.{name}"))
