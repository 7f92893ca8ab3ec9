"""The task: its instruction and its horizon; or a new task in the scene."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from simfoundry.studio.acts.task import SetTask
from simfoundry.studio.new_task import start_task
from simfoundry.studio.view.panels.panel import Panel, set_value

if TYPE_CHECKING:
    from simfoundry.studio.view.window import StudioWindow


class TaskPanel(Panel):
    """The properties of the task that is open, or a form for a new task if a scene is open."""

    def __init__(self, window: StudioWindow) -> None:
        super().__init__(window)
        gui = window.gui
        self._new = gui.add_folder("New task in this scene", visible=False)
        with self._new:
            self._name = gui.add_text("Task name", "", hint="The file is written beside the scene.")
            gui.add_button("New task").on_click(lambda _: self._create())
        self._folder = gui.add_folder("Task", visible=False, expand_by_default=False)
        with self._folder, gui.add_form(None) as form:
            self._instruction = gui.add_text("Instruction", "")
            self._horizon = gui.add_number("Horizon [steps]", 600, min=1, step=1)
            gui.add_button("Apply to task").on_click(lambda _: form.submit())
        form.on_submit(lambda _: self._submit())
        self._shown: dict[int, Any] = {}

    def refresh(self) -> None:
        """Show the task."""
        task = self.session.scene.task if self.session.scene is not None else None
        for folder, is_shown in ((self._new, task is None), (self._folder, task is not None)):
            if folder.visible != is_shown:
                folder.visible = is_shown
        if task is None:
            return
        for handle, value in ((self._instruction, task.instruction), (self._horizon, task.horizon)):
            if self._shown.get(id(handle)) != value:  # else a person may be typing another value
                self._shown[id(handle)] = value
                set_value(handle, value)

    def _submit(self) -> None:
        task = self.session.scene.task if self.session.scene is not None else None
        if task is None:
            return
        given = {"instruction": self._instruction.value.strip(), "horizon": int(self._horizon.value)}
        values = {key: value for key, value in given.items() if value != getattr(task, key)}
        if values:
            self.window.submit(SetTask(values))

    def _create(self) -> None:
        name = self._name.value.strip()
        self.window.run(lambda: start_task(self.session, name))
