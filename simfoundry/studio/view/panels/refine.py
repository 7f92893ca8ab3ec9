"""Refine poses by buttons and keys: steps along chosen axes, with the fit to the capture live, and registration."""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from simfoundry.capture.outputs.overlay import object_surface
from simfoundry.capture.shapes.evidence import RayAgreement
from simfoundry.capture.shapes.register_mesh import registered_pose
from simfoundry.geometry.frames import Array, Pose
from simfoundry.geometry.similarity import Similarity
from simfoundry.scene.object_shapes import world_bounds
from simfoundry.studio.acts.act import Act, ActError
from simfoundry.studio.acts.background import AlignBackground, background_similarity, turned_about
from simfoundry.studio.acts.move import MoveObject
from simfoundry.studio.acts.refine import RefinePose, ScaleObject, nudged
from simfoundry.studio.reading import StudioScene
from simfoundry.studio.view.capture_link import FitMeter
from simfoundry.studio.view.panels.capture import CapturePanel
from simfoundry.studio.view.panels.panel import Panel, by_person, set_value

if TYPE_CHECKING:
    from simfoundry.studio.view.window import StudioWindow

# Frames along whose axes things are nudged.
WORLD, CAMERA, OBJECT, VIEW = "world", "camera", "object", "this view"

# Steps at first: the size of the errors that remain after a reconstruction.
STEP_MM, TURN_DEG, SCALE_PERCENT = 1.0, 1.0, 1.0

# Least and greatest step [mm or deg]: what is written to the text at least, and half a turn.
MIN_STEP, MAX_STEP = 0.1, 180.0

# Keys of each step, which are free in the browser's view: W, A, S, D, Q and E fly there. With Shift, they turn.
KEYS = {"J": (0, -1), "L": (0, 1), "K": (1, -1), "I": (1, 1), "U": (2, -1), "O": (2, 1)}

AXES = "xyz"


class RefinePanel(Panel):
    """Steps, turns and scale of the selected object, or of the background, and the fit of the object."""

    def __init__(self, window: StudioWindow) -> None:
        super().__init__(window)
        gui = window.gui
        with gui.add_folder("Refine"):
            self.fit = gui.add_markdown("")
            self.axes = gui.add_dropdown("Axes", (WORLD, CAMERA, OBJECT, VIEW), initial_value=WORLD)
            self.step = gui.add_number("Step [mm]", STEP_MM, min=MIN_STEP, max=MAX_STEP, step=0.01)
            self.turn = gui.add_number("Turn [°]", TURN_DEG, min=MIN_STEP, max=MAX_STEP, step=0.01)
            self.percent = gui.add_number("Scale step [%]", SCALE_PERCENT, min=0.01, max=50.0, step=0.01)
            steps = gui.add_button_group("Move", tuple(f"{sign}{axis}" for axis in AXES for sign in "−+"))
            turns = gui.add_button_group("Turn about", tuple(f"{sign}{axis}" for axis in AXES for sign in "−+"))
            scales = gui.add_button_group("Scale", ("smaller", "larger"))
            self._snap = gui.add_button("Snap to best fit", visible=False)
            gui.add_markdown(
                "Keys: J/L, K/I, U/O move along x, y, z; with Shift, they turn. N/M halve or double steps."
            )
        steps.on_click(lambda event: self._press(event, False))
        turns.on_click(lambda event: self._press(event, True))
        scales.on_click(lambda event: self._run(lambda scene: self._scaled(scene, event.target.value == "larger")))
        self._snap.on_click(lambda _: self._run(self._registered))
        for key, (axis, sign) in KEYS.items():
            for is_turn in (False, True):
                label = f"{'Turn about' if is_turn else 'Move along'} {'−' if sign < 0 else ''}{AXES[axis]}"
                command = gui.add_command(label, hotkey=key, modifier="shift" if is_turn else None)  # type: ignore[arg-type]
                command.on_trigger(partial(self._key, axis, sign, is_turn))
        gui.add_command("Halve the steps", hotkey="N").on_trigger(lambda _: self._change_steps(0.5))
        gui.add_command("Double the steps", hotkey="M").on_trigger(lambda _: self._change_steps(2.0))
        self.axes.on_update(by_person(lambda _: window.request_refresh()))
        self._meter = FitMeter(window, window.capture, self._show_fit)
        self._measured: tuple[str, Any] = ("", None)
        window.move_act = self.move_act
        window.previews.append(self._preview)

    def refresh(self) -> None:
        """Show the fit of the selected object."""
        scene, name = self.session.scene, self.window.selected_object
        is_known = scene is not None and name in scene.objects and self.window.capture.evidence(name) is not None
        if self._snap.visible != is_known:
            self._snap.visible = is_known
        if scene is None or not is_known:
            set_value(self.fit, "Select a reconstructed object to see how well it fits." if scene is not None else "")
            self._measured = ("", None)
        elif self._measured != (name, scene.objects[name]) and self.window.gizmo.dragged_by is None:
            self._measured = (name, scene.objects[name])
            self._meter.request(name, scene.objects[name].X_WO)

    def move_act(self, name: str, X_WO: Pose) -> Act:
        """Return the act of an object that is dragged: a refinement if the capture shows the object."""
        window = self.window
        evidence = window.capture.evidence(name)
        if evidence is None:
            return MoveObject(name, X_WO, drop=window.drops, snap=window.snap)
        return RefinePose(name, X_WO, evidence, drop=window.drops, snap=window.snap)

    def _preview(self, node: str, X_WO: Pose) -> None:
        section, _, name = node.strip("/").partition("/")
        if section == "objects":
            self._meter.request(name, X_WO)

    def _show_fit(self, name: str, X_WO: Pose, found: RayAgreement) -> None:
        if name == self.window.selected_object:
            set_value(self.fit, fit_text(name, found))
            self.window.panel(CapturePanel).show_errors(name, X_WO)
            self.window.server.flush()

    # -- steps --------------------------------------------------------------------------------------------------------

    def _press(self, event: Any, is_turn: bool) -> None:
        sign, axis = event.target.value[0], event.target.value[1]
        self._nudge(AXES.index(axis), -1 if sign == "−" else 1, is_turn, event.client)

    def _key(self, axis: int, sign: int, is_turn: bool, event: Any) -> None:
        self._nudge(axis, sign, is_turn, event.client)

    def _nudge(self, axis: int, sign: int, is_turn: bool, client: Any) -> None:
        size = math.radians(float(self.turn.value)) if is_turn else float(self.step.value) / 1000
        amount = np.eye(3)[axis] * sign * size
        step, turn = (np.zeros(3), amount) if is_turn else (amount, np.zeros(3))
        R_WV = Pose.of(q=client.camera.wxyz).rotation if client is not None else np.eye(3)
        self._run(lambda scene: self._nudged(scene, step, turn, R_WV))

    def _run(self, make: Any) -> None:
        """Make an act of the scene as it is after all acts before, and apply it."""

        def work() -> None:
            scene = self.session.scene
            if scene is None:
                return
            act = make(scene)
            notes = self.session.apply(act)
            if notes:
                self.window.tell(act.label, " ".join(f"{note}." for note in notes))

        self.window.run(work)

    def _nudged(self, scene: StudioScene, step: Array, turn: Array, R_WV: Array) -> Act:
        name = self.window.selected_object
        if self.window.selection == "background":
            S_WF = background_similarity(scene)
            R_WA = self._axes(scene, S_WF.X_AB, R_WV)
            return AlignBackground(Similarity(nudged(S_WF.X_AB, R_WA, S_WF.X_AB.p, step, turn), S_WF.scale))
        if name not in scene.objects:
            raise ActError("select an object or the background first")
        item = scene.objects[name]
        middle = np.mean(world_bounds(item, item.X_WO), axis=0)
        X_WO = nudged(item.X_WO, self._axes(scene, item.X_WO, R_WV), middle, step, turn)
        return RefinePose(name, X_WO, self.window.capture.evidence(name))

    def _axes(self, scene: StudioScene, X_WO: Pose, R_WV: Array) -> Array:
        """Return the chosen axes in the world, shape (3, 3); those of cameras are x right, y down and z forward."""
        chosen = self.axes.value
        if chosen == OBJECT:
            return X_WO.rotation
        if chosen == VIEW:
            return R_WV
        if chosen == CAMERA:
            cameras = {camera.name: camera for camera in scene.scene.cameras}
            found = cameras.get(scene.spec.viewpoint or "") or next(iter(cameras.values()), None)
            if found is None:
                raise ActError("the scene has no camera; choose other axes")
            return found.X_WC.rotation
        return np.eye(3)

    def _scaled(self, scene: StudioScene, is_larger: bool) -> Act:
        factor = 1 + float(self.percent.value) / 100
        factor = factor if is_larger else 1 / factor
        if self.window.selection == "background":
            S_WF = background_similarity(scene)
            return AlignBackground(turned_about(S_WF, tuple(S_WF.X_AB.p.tolist()), Pose.of(), factor))
        if self.window.selected_object not in scene.objects:
            raise ActError("select an object or the background first")
        return ScaleObject(self.window.selected_object, factor)

    def _registered(self, scene: StudioScene) -> Act:
        name = self.window.selected_object
        evidence = self.window.capture.evidence(name)
        if evidence is None or name not in scene.objects:
            raise ActError("the capture shows nothing of the selected object")
        item = scene.objects[name]
        return RefinePose(name, registered_pose(evidence, object_surface(item), item.X_WO), evidence)

    def _change_steps(self, factor: float) -> None:
        for handle in (self.step, self.turn):
            set_value(handle, min(max(round(handle.value * factor, 4), MIN_STEP), MAX_STEP))


def fit_text(name: str, found: RayAgreement) -> str:
    """Return the fit of an object as one line."""
    error = f"{1000 * found.fit:.2f} mm" if math.isfinite(found.fit) else "none of its points is hit"
    return f"**{name}**: fit error {error}, {100 * found.explained:.0f} % of its points explained"
