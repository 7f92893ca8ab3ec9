"""Panel for moving objects: dropping, snapping, and the joints of the selected object."""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING, Any

from simfoundry.scene.model import Joint, JointType
from simfoundry.studio.acts.joints import SetJoint, movable_joints
from simfoundry.studio.acts.move import Snap
from simfoundry.studio.view.panels.panel import Panel, by_person, set_value

if TYPE_CHECKING:
    from simfoundry.studio.view.window import StudioWindow

# Grids [cm] and angles [deg] that are offered; the first ones turn snapping off.
GRIDS, ANGLES = ("off", "1 cm", "5 cm", "10 cm"), ("off", "5°", "15°", "45°", "90°")


class MovingPanel(Panel):
    """Switches for dropping and snapping."""

    def __init__(self, window: StudioWindow) -> None:
        super().__init__(window)
        with window.gui.add_folder("When moved", expand_by_default=False):
            self._drop = window.gui.add_checkbox("Drop", True, hint="Let go, and it falls onto what is beneath.")
            self._grid = window.gui.add_dropdown("Grid", GRIDS, initial_value="off")
            self._angle = window.gui.add_dropdown("Angles", ANGLES, initial_value="off")
        for handle in (self._drop, self._grid, self._angle):
            handle.on_update(by_person(lambda _: self._update()))

    def _update(self) -> None:
        grid = 0.0 if self._grid.value == "off" else float(self._grid.value.split()[0]) / 100
        angle = 0.0 if self._angle.value == "off" else float(self._angle.value.rstrip("°"))
        self.window.drops, self.window.snap = bool(self._drop.value), Snap(grid, angle)


class JointPanel(Panel):
    """A slider for each joint of the selected object."""

    def __init__(self, window: StudioWindow) -> None:
        super().__init__(window)
        self._folder = window.gui.add_folder("Joints", visible=False)
        self._sliders: dict[str, Any] = {}
        self._shown: tuple[Any, ...] = ()

    def refresh(self) -> None:
        """Show the joints of the selected object, at their present positions."""
        scene, name = self.session.scene, self.window.selected_object
        joints = movable_joints(scene, name) if scene is not None and name in scene.objects else ()
        shown = (name, *((joint.name, joint.limits) for joint in joints))
        if shown != self._shown:
            self._shown = shown
            for slider in self._sliders.values():
                slider.remove()
            self._sliders = {}
            self._folder.visible = bool(joints)
            with self._folder:
                for joint in joints:
                    self._add(name, joint)
        for joint in joints:
            set_value(self._sliders[joint.name], _shown_position(joint))

    def _add(self, name: str, joint: Joint) -> None:
        is_angle = joint.type is not JointType.PRISMATIC
        low, high = joint.limits or (-math.pi, math.pi)
        scale, step, unit = (180 / math.pi, 0.5, "°") if is_angle else (1.0, 0.001, "m")
        low, high = math.floor(low * scale / step) * step, math.ceil(high * scale / step) * step
        slider = self.window.gui.add_slider(
            f"{joint.name} [{unit}]",
            min=low,
            max=max(high, low + step),
            step=step,
            initial_value=_shown_position(joint),
        )
        slider.on_update(by_person(partial(self._move, name, joint.name, scale)))
        self._sliders[joint.name] = slider

    def _move(self, name: str, joint: str, scale: float, event: Any) -> None:
        self.window.submit_latest(SetJoint(name, joint, float(event.target.value) / scale), f"joint {name}.{joint}")


def _shown_position(joint: Joint) -> float:
    position = joint.position if joint.type is JointType.PRISMATIC else math.degrees(joint.position)
    return round(position, 4)
