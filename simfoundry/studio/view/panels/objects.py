"""The selection, and the properties of the selected object."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from simfoundry.spec.models.base import quantity_value
from simfoundry.studio.acts.names import RenameSymbol
from simfoundry.studio.acts.properties import SetProperties
from simfoundry.studio.view.panels.panel import Panel, by_person, set_value

if TYPE_CHECKING:
    from simfoundry.studio.view.window import StudioWindow

NOTHING = "(nothing)"
INHERITED = "(none)"


class ObjectPanel(Panel):
    """Selection by name, and the name, mass, friction, material and category of the selected object."""

    def __init__(self, window: StudioWindow) -> None:
        super().__init__(window)
        gui = window.gui
        self._select = gui.add_dropdown("Selected", (NOTHING,), initial_value=NOTHING)
        self._select.on_update(by_person(lambda event: window.select(_selection(event.target.value))))
        self._folder = gui.add_folder("Object", visible=False)
        with self._folder:
            with gui.add_form(None) as form:
                self._name = gui.add_text("Name", "")
                self._category = gui.add_text("Category", "")
                self._mass = gui.add_number("Mass [kg]", 0.0, min=0.0, step=0.001)
                self._friction = gui.add_number("Friction", 0.0, min=0.0, step=0.01)
                self._material = gui.add_dropdown("Material", (INHERITED,), initial_value=INHERITED)
                self._fixed = gui.add_checkbox("Fixed", False)
                gui.add_button("Apply").on_click(lambda _: form.submit())
            form.on_submit(lambda _: self._submit())
        self._shown: dict[int, tuple[str, Any]] = {}  # the object and the value that each control has shown

    def refresh(self) -> None:
        """Show the objects, and the properties of the selected one."""
        scene = self.session.scene
        names = (NOTHING, *(scene.objects if scene is not None else ()))
        if self._select.options != names:
            self._select.options = names
        name = self.window.selected_object
        set_value(self._select, name if name in names else NOTHING)
        shown = scene is not None and name in scene.objects
        if self._folder.visible != shown:
            self._folder.visible = shown
        if scene is None or not shown:
            return
        materials = (INHERITED, *scene.spec.materials)
        if self._material.options != materials:
            self._material.options = materials
        for handle, value in self._values(name):
            if self._shown.get(id(handle)) != (name, value):  # else a person may be typing another value
                self._shown[id(handle)] = name, value
                set_value(handle, value)

    def _values(self, name: str) -> list[tuple[Any, Any]]:
        """Return the present value of each control."""
        scene = self.session.scene
        assert scene is not None
        spec, item = scene.spec.objects[name], scene.objects[name]
        mass = quantity_value(spec.mass)
        collider = next((c for link in item.links for c in link.colliders), None)
        return [
            (self._name, name),
            (self._category, item.category),
            (self._mass, round(sum(link.mass for link in item.links) if mass is None else mass, 6)),
            (self._friction, round(collider.friction if collider is not None else 0.0, 6)),
            (self._material, spec.material or INHERITED),
            (self._fixed, spec.fixed),
        ]

    def _submit(self) -> None:
        """Apply what differs from the present values."""
        name = self.window.selected_object
        with self.session.lock:
            if self.session.scene is None or name not in self.session.scene.objects:
                return
            changed = {id(handle) for handle, value in self._values(name) if handle.value != value}
        keys: dict[str, Any] = {"category": self._category, "mass": self._mass}
        keys |= {"friction": self._friction, "fixed": self._fixed}
        values: dict[str, Any] = {key: handle.value for key, handle in keys.items() if id(handle) in changed}
        if "fixed" in values and not values["fixed"]:
            values["fixed"] = None
        if "category" in values and not values["category"]:
            values["category"] = None
        if id(self._material) in changed:
            values["material"] = None if self._material.value == INHERITED else self._material.value
        if values:
            self.window.submit(SetProperties(name, values))
        if id(self._name) in changed:
            new = self._name.value.strip()
            self.window.submit(RenameSymbol(f"objects.{name}", new), then=lambda: self.window.select(f"objects.{new}"))


def _selection(name: str) -> str:
    return "" if name == NOTHING else f"objects.{name}"
