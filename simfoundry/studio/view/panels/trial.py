"""Panel that states what is shown in place of the document, and returns to the document."""

from __future__ import annotations

from typing import TYPE_CHECKING

from simfoundry.studio.view.panels.panel import Panel, set_value

if TYPE_CHECKING:
    from simfoundry.studio.view.window import StudioWindow


class TrialPanel(Panel):
    """The latest message about what is tried, and a button that shows the document again."""

    edits = False

    def __init__(self, window: StudioWindow) -> None:
        super().__init__(window)
        self._message = window.gui.add_markdown("")
        self._back = window.gui.add_button("Back to the document", visible=False)
        self._back.on_click(lambda _: window.stage.end())

    def refresh(self) -> None:
        """Follow what is shown."""
        stage = self.window.stage
        is_shown = stage.trial is not None or stage.cousin is not None
        set_value(self._message, stage.message or ("" if is_shown else "Nothing here changes the text by itself."))
        if self._back.visible != is_shown:
            self._back.visible = is_shown
