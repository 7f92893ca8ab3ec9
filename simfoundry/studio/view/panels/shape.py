"""The size and the color of the selected object."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

from simfoundry.studio.acts.properties import SetProperties
from simfoundry.studio.acts.resize import ResizeObject, shape_lengths
from simfoundry.studio.view.panels.panel import Panel, by_person, set_value

if TYPE_CHECKING:
    from simfoundry.studio.view.window import StudioWindow

# Step [cm] of the buttons at each length, and the smallest and the largest length [cm]: a crumb, and a hall.
STEP_CM, LEAST_CM, LARGEST_CM = 1.0, 0.1, 10_000.0


class ShapePanel(Panel):
    """A number for each length of the selected object's shape, and its color."""

    def __init__(self, window: StudioWindow) -> None:
        super().__init__(window)
        self._folder = window.gui.add_folder("Size and color", visible=False)
        with self._folder:
            self.color = window.gui.add_rgb("Color", (128, 128, 128))
        self.color.on_update(by_person(lambda event: self._paint(event.target.value)))
        self._numbers: dict[str, Any] = {}
        self._shown: tuple[Any, ...] = ()

    def refresh(self) -> None:
        """Show the lengths and the color of the selected object."""
        scene, name = self.session.scene, self.window.selected_object
        is_shown = scene is not None and name in scene.objects
        if self._folder.visible != is_shown:
            self._folder.visible = is_shown
        lengths = shape_lengths(self._shape(name)) if is_shown else {}
        if self._shown != (name, *lengths):
            self._shown = (name, *lengths)
            for number in self._numbers.values():
                number.remove()
            with self._folder:
                self._numbers = {length: self._number(name, length, value) for length, value in lengths.items()}
        for length, value in lengths.items():
            set_value(self._numbers[length], round(100 * value, 4))
        if is_shown and scene is not None:
            visual = next((v for link in scene.objects[name].links for v in link.visuals), None)
            if visual is not None:
                r, g, b = (round(255 * float(c)) for c in visual.rgba[:3])
                set_value(self.color, (r, g, b))

    def _shape(self, name: str) -> Mapping[str, Any]:
        document = self.session.scene.loaded.document if self.session.scene is not None else None
        data = document.data["objects"].get(name) if document is not None else None
        shape = data.get("shape") if isinstance(data, dict) else None
        return shape if isinstance(shape, dict) else {}

    def _number(self, name: str, length: str, value: float) -> Any:
        number = self.window.gui.add_number(
            f"{length} [cm]", round(100 * value, 4), min=LEAST_CM, max=LARGEST_CM, step=STEP_CM
        )
        number.on_update(by_person(partial(self._resize, name, length)))
        return number

    def _resize(self, name: str, length: str, event: Any) -> None:
        lengths = dict(shape_lengths(self._shape(name)))
        if length in lengths:
            lengths[length] = round(float(event.target.value) / 100, 6)
            self.window.submit_latest(ResizeObject(name, lengths), f"resize {name}.{length}")

    def _paint(self, rgb: tuple[int, int, int]) -> None:
        name = self.window.selected_object
        color = tuple(round(channel / 255, 3) for channel in rgb)
        if name:
            self.window.submit_latest(SetProperties(name, {"color": color}), f"color of {name}")
