"""Cousins of a run: look at one after the other, and accept or reject each of them with a reason."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from simfoundry.cousins.run.review import CousinReview
from simfoundry.errors import SimfoundryError
from simfoundry.studio.trial.cousins import CousinsTour
from simfoundry.studio.trial.folders import has_cousins
from simfoundry.studio.view.panels.folders import FolderChoice
from simfoundry.studio.view.panels.panel import Panel, set_value

if TYPE_CHECKING:
    from simfoundry.studio.view.window import StudioWindow

# Number of values of a cousin that are listed; the manifest contains all of them.
MAX_LISTED = 12


class CousinsPanel(Panel):
    """The choice of a run, the steps through its cousins, and the decision about the present one."""

    def __init__(self, window: StudioWindow) -> None:
        super().__init__(window)
        gui = window.gui
        with gui.add_folder("Cousins", expand_by_default=False):
            self._folders = FolderChoice(window, "Cousin run", "cousins", has_cousins, self._open)
            self._review = gui.add_folder("Review", visible=False)
            with self._review:
                step = gui.add_button_group("Cousin", ("Previous", "Next"))
                step.on_click(lambda event: window.stage.run(lambda: self._step(event.target.value)))
                self._status = gui.add_markdown("")
                self._reason = gui.add_text("Reason", "")
                decide = gui.add_button_group("Decide", ("Accept", "Reject", "Clear"))
                decide.on_click(lambda event: window.stage.run(lambda: self._decide(event.target.value)))
        self._tour: CousinsTour | None = None
        self._shown: object = None  # the cousin and the review that the reason has shown

    def refresh(self) -> None:
        """Show what was decided about the present cousin."""
        tour = self._tour
        if self._review.visible != (tour is not None):
            self._review.visible = tour is not None
        if tour is None:
            return
        set_value(self._status, description(tour))
        if self._shown != (tour, tour.position, tour.review):  # else a person may be typing a reason
            self._shown = tour, tour.position, tour.review
            set_value(self._reason, tour.review.reason if tour.review is not None else "")

    def _open(self, folder: Path) -> None:
        self._tour = CousinsTour(folder)
        self._show()

    def _step(self, button: str) -> None:
        if self._tour is not None:
            self._tour.move(1 if button == "Next" else -1)
            self._show()

    def _decide(self, button: str) -> None:
        if self._tour is None:
            return
        review = None if button == "Clear" else CousinReview(button == "Accept", self._reason.value.strip())
        self._tour.decide(review)
        if review is not None:
            self._tour.move(1)
        self._show()

    def _show(self) -> None:
        tour, stage = self._tour, self.window.stage
        assert tour is not None
        try:
            scene = tour.scene()
        except SimfoundryError:
            stage.show_cousin(None)  # so that nobody takes another one for it
            raise
        stage.message = ""
        stage.show_cousin(scene)


def description(tour: CousinsTour) -> str:
    """Return what a person must know about the present cousin."""
    cousin, review = tour.present, tour.review
    accepted, rejected, is_open = tour.counts
    state = "not reviewed" if review is None else "**accepted**" if review.accepted else "**rejected**"
    lines = [f"Cousin {cousin.index}, {tour.position + 1} of {len(tour.cousins)}: {state}"]
    lines.append(f"{accepted} accepted, {rejected} rejected, {is_open} open")
    lines += [f"`{text}`" for text in (*cousin.asked, *([f"goal: {cousin.goal}"] if cousin.goal else []))]
    values = list((cousin.vary or {}).items())
    lines += [f"`{path}`: {value}" for path, value in values[:MAX_LISTED]]
    lines += [f"and {len(values) - MAX_LISTED} more values"] if len(values) > MAX_LISTED else []
    return "  \n".join(lines)
