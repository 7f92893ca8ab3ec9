"""The document: undo and redo, the diff to the file on disk, saving, and questions about changes on disk."""

from __future__ import annotations

import html
from functools import partial
from typing import TYPE_CHECKING, Any

from simfoundry.studio.disk import DiskQuestion
from simfoundry.studio.view.panels.panel import Panel, plain_markdown, set_value

if TYPE_CHECKING:
    from simfoundry.studio.view.window import StudioWindow

# Number of lines of a diff that are shown; a longer one is easier to read in an editor.
MAX_LINES = 400

# Height of the diff, which is always visible, and must leave room for the tabs below it: the change of one value with
# the lines around it.
HEIGHT = "12em"

_COLORS = {"+": "#d7f5dd", "-": "#fbdada", "@": "#e4ecf7"}


class DocumentPanel(Panel):
    """Undo, redo, save, and the diff that saving would write."""

    def __init__(self, window: StudioWindow) -> None:
        super().__init__(window)
        gui = window.gui
        self._state = gui.add_markdown("")
        self._buttons = gui.add_button_group("", ("Undo", "Redo", "Save"))
        self._buttons.on_click(lambda event: self._press(event.target.value))
        self._questions = gui.add_folder("Changed here and on disk", visible=False)
        self._asked: tuple[Any, ...] = ()
        self._controls: list[Any] = []
        with gui.add_folder("Diff to the file"):
            self._diff = gui.add_html("")
        undo = gui.add_command("Undo", hotkey="Z", modifier="cmd/ctrl")
        redo = gui.add_command("Redo", hotkey="Z", modifier="cmd/ctrl+shift")
        save = gui.add_command("Save", hotkey="S", modifier="cmd/ctrl")
        for command, button in ((undo, "Undo"), (redo, "Redo"), (save, "Save")):
            command.on_trigger(partial(self._trigger, button))

    def refresh(self) -> None:
        """Show what can be undone, and what saving would write."""
        session = self.session
        name = session.shown_path(session.path)
        edited = " (edited)" if session.is_modified else ""
        steps = [
            f"{word}: {label}" for word, label in (("undo", session.undo_label), ("redo", session.redo_label)) if label
        ]
        set_value(self._state, "  \n".join([f"**{name}**{edited}", *steps]))
        set_value(self._diff, diff_html(session.diff()))
        self._ask()

    def _trigger(self, button: str, _event: object) -> None:
        self._press(button)

    def _press(self, button: str) -> None:
        work = {"Undo": self.session.undo, "Redo": self.session.redo}
        if button in work:
            self.window.run(work[button])
        else:
            self.window.save()

    def _ask(self) -> None:
        questions = self.session.questions
        if questions == self._asked:
            return
        self._asked = questions
        for control in self._controls:
            control.remove()
        self._controls = []
        self._questions.visible = bool(questions)
        with self._questions:
            for question in questions:
                self._controls.append(self.window.gui.add_markdown(plain_markdown(str(question))))
                choice = self.window.gui.add_button_group("Keep", ("here", "on disk"))
                choice.on_click(partial(self._answer, question))
                self._controls.append(choice)

    def _answer(self, question: DiskQuestion, event: Any) -> None:
        self.window.run(partial(self.session.answer, question, event.target.value == "on disk"))


def diff_html(diff: str) -> str:
    """Return a unified diff as HTML with colored lines."""
    lines = diff.splitlines()
    if not lines:
        return '<p style="margin:0.4em">The file contains everything.</p>'
    rows = []
    for k, line in enumerate(lines[:MAX_LINES]):
        if line.startswith("+++ ") and k and lines[k - 1] == f"---{line[3:]}":
            continue  # the name of the file, once more
        color = "" if line.startswith(("+++", "---")) else _COLORS.get(line[:1], "")
        style = f' style="background:{color};color:#111"' if color else ""
        rows.append(f"<div{style}>{html.escape(line) or '&nbsp;'}</div>")
    if len(lines) > MAX_LINES:
        rows.append(f"<div>… and {len(lines) - MAX_LINES} more lines</div>")
    body = "".join(rows)
    style = (
        f"font-family:monospace;font-size:0.72em;white-space:pre-wrap;margin:0.4em;max-height:{HEIGHT};overflow:auto"
    )
    return f'<div style="{style}">{body}</div>'
