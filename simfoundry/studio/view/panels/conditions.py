"""Relations, the goal and the steps, with their truth and margin at the moment."""

from __future__ import annotations

import html
from typing import TYPE_CHECKING

from simfoundry.spec.models.predicate import ExpressionError, parse_call
from simfoundry.studio.reading import StudioScene, verdict
from simfoundry.studio.view.panels.panel import Panel, set_value

if TYPE_CHECKING:
    from simfoundry.studio.view.window import StudioWindow


class ConditionsPanel(Panel):
    """A table of all predicates that the documents state."""

    def __init__(self, window: StudioWindow) -> None:
        super().__init__(window)
        self._table = window.gui.add_html("")
        self._judged: tuple[object, ...] = ()

    def refresh(self) -> None:
        """Judge the predicates in the state that is shown."""
        scene, state = self.session.scene, self.window.state
        if scene is None or self._judged == (scene, state):
            return
        self._judged = (scene, state)
        rows = "".join(_row(scene, source, text, self.window.state) for source, text in scene.conditions)
        empty = "The documents state no relations and no goal."
        set_value(self._table, f'<table style="font-size:0.8em;margin:0.4em">{rows or empty}</table>')


def _row(scene: StudioScene, source: str, text: str, state: object) -> str:
    from simfoundry.scene.state import SceneState

    found = verdict(scene, text, state if isinstance(state, SceneState) else None)
    try:
        unit = parse_call(text).declaration.unit
    except ExpressionError:
        unit = ""
    truth = "–" if found is None else "true" if found.value else "false"
    color = "#888" if found is None else "#1a8f3c" if found.value else "#c22"
    margin = "" if found is None else f"{found.margin:+.3g} {unit}"
    why = "it cannot be judged before a robot moves" if found is None else found.why
    cells = (source, text, f'<b style="color:{color}">{truth}</b>', margin)
    shown = (html.escape(c) if k != 2 else c for k, c in enumerate(cells))
    return f'<tr title="{html.escape(why, quote=True)}">{"".join(f"<td>{c}&nbsp;</td>" for c in shown)}</tr>'
