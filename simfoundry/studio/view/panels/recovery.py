"""Edits that an earlier studio left unsaved, because it was killed or stopped: restore them or discard them."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

from simfoundry.studio.history import UnsavedState
from simfoundry.studio.view.panels.panel import Panel, plain_markdown, set_value

if TYPE_CHECKING:
    from simfoundry.studio.view.window import StudioWindow

# Number of steps that are listed; the diff shows all of them once they are restored.
MAX_LISTED = 5


class RecoveryPanel(Panel):
    """One question for each earlier studio with unsaved edits. It is hidden if there is none."""

    def __init__(self, window: StudioWindow) -> None:
        super().__init__(window)
        self._problem = window.gui.add_markdown("", visible=False)
        self._folder = window.gui.add_folder("Unsaved edits of an earlier studio", visible=False)
        self._shown: tuple[UnsavedState, ...] = ()
        self._controls: list[Any] = []

    def refresh(self) -> None:
        """Show what can be restored."""
        journal = self.window.journal
        if journal is None:
            return
        set_value(self._problem, journal.problem)
        if self._problem.visible != bool(journal.problem):
            self._problem.visible = bool(journal.problem)
        if journal.unsaved == self._shown:
            return
        self._shown = journal.unsaved
        for control in self._controls:
            control.remove()
        self._controls = []
        self._folder.visible = bool(self._shown)
        with self._folder:
            for state in self._shown:
                self._controls.append(self.window.gui.add_markdown(plain_markdown(description(state))))
                choice = self.window.gui.add_button_group("These edits", ("Restore", "Discard"))
                choice.on_click(partial(self._answer, state))
                self._controls.append(choice)

    def _answer(self, state: UnsavedState, event: Any) -> None:
        journal = self.window.journal
        if journal is not None:
            is_restored = event.target.value == "Restore"
            self.window.run(partial(journal.restore if is_restored else journal.discard, state))


def description(state: UnsavedState) -> str:
    """Return a sentence about the edits that can be restored."""
    labels = state.history.labels
    listed = ", ".join(labels[-MAX_LISTED:]) or "edits"
    more = f" (and {len(labels) - MAX_LISTED} earlier ones)" if len(labels) > MAX_LISTED else ""
    names = ", ".join(path.name for path, text in state.texts.items() if state.files.get(path) != text)
    return f"{listed}{more} in {names}"
