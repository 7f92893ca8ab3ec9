"""Align the background, a mesh or a splat: by a gizmo and a slider, by pairs of points, and by the keys of *Refine*."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from simfoundry.geometry.frames import Pose
from simfoundry.geometry.similarity import Similarity
from simfoundry.scene.model import Background, Scene
from simfoundry.studio.acts.background import AlignBackground, AlignByPoints, Point, background_similarity
from simfoundry.studio.view.contents import LabelContent
from simfoundry.studio.view.nodes import Nodes, ViewNode, background_nodes
from simfoundry.studio.view.panels.panel import Panel, by_person, set_value
from simfoundry.studio.view.picking import background_point, scene_point

if TYPE_CHECKING:
    from simfoundry.studio.view.window import StudioWindow

# Range of the slider for the scale, as powers of ten: from files in millimeters to those in kilometers.
DECADES = 3.0


class BackgroundPanel(Panel):
    """Selection of the background, its scale, and pairs of points."""

    def __init__(self, window: StudioWindow) -> None:
        super().__init__(window)
        gui = window.gui
        self._folder = gui.add_folder("Background", visible=False)
        with self._folder:
            self.shown = gui.add_checkbox("Show the background", True)
            self.select = gui.add_checkbox("Move the background", False, hint="By the arrows, or the keys of Refine.")
            self.scale = gui.add_slider("Scale [log10]", min=-DECADES, max=DECADES, step=0.001, initial_value=0.0)
            self._pairs = gui.add_markdown("")
            self.picking = gui.add_checkbox("Pick pairs", False, hint="Click on the background, then on the scene.")
            self.pair = gui.add_button_group("Pairs", ("align", "forget"))
            with gui.add_folder("Pair by coordinates", expand_by_default=False):
                self.here = gui.add_vector3("On the background [m]", (0.0, 0.0, 0.0), step=0.001)
                self.there = gui.add_vector3("In the scene [m]", (0.0, 0.0, 0.0), step=0.001)
                add = gui.add_button("Add pair")
        self.pairs: list[tuple[Point, Point]] = []
        self._half: Point | None = None
        self.shown.on_update(lambda _: window.request_refresh())
        self.select.on_update(by_person(lambda event: window.select("background" if event.target.value else "")))
        self.scale.on_update(by_person(lambda event: self._scale(float(event.target.value))))
        self.picking.on_update(by_person(lambda event: self._listen(bool(event.target.value))))
        self.pair.on_click(lambda event: self._pair(event.target.value))
        add.on_click(lambda _: self._add(_point(self.here.value), _point(self.there.value)))

    @property
    def _surroundings(self) -> Scene | None:
        scene = self.session.scene
        return scene.surroundings if scene is not None else None

    @property
    def _background(self) -> Background | None:
        return self._surroundings.background if self._surroundings is not None else None

    def refresh(self) -> None:
        """Show the scale and the pairs."""
        visible = self._background is not None
        if self._folder.visible != visible:
            self._folder.visible = visible
        set_value(self.select, self.window.selection == "background")
        scene = self.session.scene
        if visible and scene is not None and scene.spec.background is not None:
            power = math.log10(scene.spec.background.scale)
            set_value(self.scale, round(min(max(power, -DECADES), DECADES), 3))
        step = ""
        if self.picking.value:
            step = " Click on the background." if self._half is None else " Now click on the same point of the scene."
        set_value(self._pairs, f"{len(self.pairs)} pairs; three are needed.{step}")

    def nodes(self) -> Nodes:
        """Return the background and the points of the pairs."""
        surroundings = self._surroundings
        nodes = background_nodes(surroundings) if surroundings is not None and self.shown.value else {}
        for k, (here, there) in enumerate(self.pairs):
            nodes[f"/pair_{k}_here"] = ViewNode(LabelContent(f"{k + 1}"), Pose.of(here))
            nodes[f"/pair_{k}_there"] = ViewNode(LabelContent(f"{k + 1}"), Pose.of(there))
        if self._half is not None:
            nodes["/pair_half"] = ViewNode(LabelContent(f"{len(self.pairs) + 1}"), Pose.of(self._half))
        return nodes

    def _scale(self, power: float) -> None:
        scene = self.session.scene
        if scene is None or scene.spec.background is None:
            return
        S_WF = background_similarity(scene)
        self.window.submit_latest(AlignBackground(Similarity(S_WF.X_AB, 10.0**power)), "background scale")

    def _pair(self, button: str) -> None:
        pairs = tuple(self.pairs)
        if button == "align":
            self.window.submit(AlignByPoints(pairs), then=self._forget)
        else:
            self._forget()

    def _forget(self) -> None:
        self.pairs, self._half = [], None
        self.window.request_refresh()

    def _add(self, here: Point, there: Point) -> None:
        self.pairs.append((here, there))
        self.window.request_refresh()

    def _listen(self, on: bool) -> None:
        self._half = None
        self.window.is_picking = on
        self.window.request_refresh()
        scene = self.window.server.scene
        if on:
            scene.on_click()(self._click)
        else:
            scene.remove_click_callback(self._click)

    def _click(self, event: Any) -> None:
        """Take the point under a click: first on the background, then on the scene."""
        origin, direction = np.array(event.ray_origin), np.array(event.ray_direction)
        with self.session.lock:
            scene, background = self.session.scene, self._background
        if scene is None or background is None:
            return
        if self._half is None:
            self._half = found = background_point(background, origin, direction)
        else:
            found = scene_point(scene.scene, self.window.capture.overlay, origin, direction)
            if found is not None:
                self.pairs.append((self._half, found))
                self._half = None
        if found is None:
            what = "the background" if self._half is None else "the scene or its cloud"
            self.window.tell("No point", f"the click does not meet {what}")
        self.window.request_refresh()


def _point(value: Any) -> Point:
    x, y, z = (float(v) for v in value)
    return x, y, z
