"""A choice among folders of the project, with a text for those that are not listed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from simfoundry.studio.trial.folders import IsWanted, found_folders
from simfoundry.studio.trial.recordings import inside_project
from simfoundry.studio.view.panels.panel import by_person, set_value

if TYPE_CHECKING:
    from simfoundry.studio.view.window import StudioWindow

NONE = "(none)"


class FolderChoice:
    """Controls that choose a folder: a list of those that were found, and a text.

    They are added where they are created. Folders are searched in the background.
    """

    def __init__(
        self, window: StudioWindow, label: str, what: str, is_wanted: IsWanted, chosen: Callable[[Path], object]
    ) -> None:
        """Add the controls.

        Args:
            window: The window.
            label: The label of the list.
            what: What the folders contain, in the plural.
            is_wanted: Function that decides whether a folder is listed.
            chosen: Function that opens a folder. It is called among the jobs of the stage.
        """
        gui = window.gui
        self._window, self._is_wanted, self._chosen = window, is_wanted, chosen
        self.list = gui.add_dropdown(label, (NONE,), initial_value=NONE)
        self.list.on_update(by_person(lambda event: self._choose(event.target.value)))
        gui.add_button(f"Look for {what}").on_click(lambda _: window.stage.run(self.search))
        with gui.add_folder(f"{what.capitalize()} elsewhere", expand_by_default=False):
            self.text = gui.add_text("Folder", "")
            gui.add_button(f"Open {what}").on_click(lambda _: window.stage.run(lambda: self._open(self.text.value)))
        window.server.on_client_connect(lambda _: window.stage.run(self.search))  # a reloaded page shows new folders

    def search(self) -> None:
        """List the folders of the project."""
        options = (NONE, *found_folders(self._window.session.root, self._is_wanted))
        if self.list.options != options:
            value = self.list.value
            self.list.options = options
            set_value(self.list, value if value in options else NONE)

    def _choose(self, folder: str) -> None:
        if folder != NONE:
            self._window.stage.run(lambda: self._open(folder))

    def _open(self, folder: str) -> None:
        self._chosen(inside_project(self._window.session.root, folder))
