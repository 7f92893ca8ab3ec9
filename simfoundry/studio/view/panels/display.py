"""Panel for what the view shows: materials, colliders, frames, joints, cameras, names."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, cast

from simfoundry.studio.view.panels.panel import Panel, by_person, set_value

if TYPE_CHECKING:
    from simfoundry.studio.view.window import StudioWindow

# Each switch, by the name of its option.
LABELS = {
    "visuals": "Materials",
    "colliders": "Colliders",
    "frames": "Frames",
    "joints": "Joint axes",
    "cameras": "Cameras",
    "names": "Names",
    "lights": "Lights of the scene",
    "shadows": "Shadows",
}


class DisplayPanel(Panel):
    """One switch for each part of the scene that can be hidden."""

    edits = False

    def __init__(self, window: StudioWindow) -> None:
        super().__init__(window)
        with window.gui.add_folder("Show"):
            boxes = {key: window.gui.add_checkbox(label, getattr(window.options, key)) for key, label in LABELS.items()}
        for option, box in boxes.items():
            box.on_update(by_person(partial(self._switch, option)))
        self._boxes = boxes

    def refresh(self) -> None:
        """Show which parts are visible."""
        for option, box in self._boxes.items():
            set_value(box, getattr(self.window.options, option))

    def _switch(self, option: str, event: Any) -> None:
        self.window.options = replace(self.window.options, **cast(Any, {option: bool(event.target.value)}))
        self.window.request_refresh()
