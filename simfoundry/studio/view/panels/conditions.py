"""Relations, the goal and the steps, with their truth and margin at the moment; and controls to add and remove them."""

from __future__ import annotations

import html
from typing import TYPE_CHECKING, Any

from simfoundry.scene.state import SceneState
from simfoundry.spec.models.predicate import PREDICATES, ExpressionError, parse_call
from simfoundry.studio.acts.conditions import AddGoal, AddRelation, RemoveGoal, RemoveRelation
from simfoundry.studio.reading import StudioScene, verdict
from simfoundry.studio.view.panels.panel import Panel, by_person, set_value

if TYPE_CHECKING:
    from simfoundry.studio.view.window import StudioWindow

# What a predicate can be added to.
RELATION, GOAL = "relations", "goal"

NONE = "–"


class ConditionsPanel(Panel):
    """A table of all predicates that the documents state, in the state that is shown."""

    edits = False

    def __init__(self, window: StudioWindow) -> None:
        super().__init__(window)
        self._table = window.gui.add_html("")
        self._judged: tuple[object, ...] = ()

    def refresh(self) -> None:
        """Judge the predicates."""
        scene, state = self.window.shown_scene, self.window.shown_state
        if scene is None or self._judged == (scene, state):
            return
        self._judged = (scene, state)
        rows = "".join(_row(scene, source, text, state) for source, text in scene.conditions)
        empty = "The documents state no relations and no goal."
        set_value(self._table, f'<table style="font-size:0.8em;margin:0.4em">{rows or empty}</table>')


class PredicatePanel(Panel):
    """Add a predicate to the relations or to the goal, with the names that fit, and remove one."""

    def __init__(self, window: StudioWindow) -> None:
        super().__init__(window)
        gui = window.gui
        with gui.add_folder("Add a condition"):
            self._target = gui.add_dropdown("To", (RELATION,), initial_value=RELATION)
            self._predicate = gui.add_dropdown("Predicate", tuple(PREDICATES.built_in), initial_value="OnTop")
            self._arguments = [gui.add_dropdown(label, (NONE,), initial_value=NONE) for label in ("First", "Second")]
            self._truth = gui.add_markdown("")
            gui.add_button("Add condition").on_click(lambda _: self._add())
        for handle in (self._predicate, *self._arguments):
            handle.on_update(by_person(lambda _: self.window.request_refresh()))
        with gui.add_folder("Remove a condition", expand_by_default=False):
            self._stated = gui.add_dropdown("Condition", (NONE,), initial_value=NONE)
            gui.add_button("Remove condition").on_click(lambda _: self._remove())

    def refresh(self) -> None:
        """Offer the names that fit the predicate, and show whether it holds."""
        scene = self.session.scene
        if scene is None:
            return
        targets = (RELATION,) if scene.task is None else (GOAL, RELATION)
        if self._target.options != targets:
            self._target.options = targets
            set_value(self._target, targets[0])
        kinds = PREDICATES.load(self._predicate.value).parameters
        for k, handle in enumerate(self._arguments):
            names = fitting_names(scene, kinds[k]) if k < len(kinds) else ()
            options = names or (NONE,)
            if handle.options != options:
                handle.options = options
            if handle.value not in options:
                set_value(handle, options[min(k, len(options) - 1)])  # two different names
        found = verdict(scene, self._text(), self.window.shown_state)
        judged = f" is **{str(found.value).lower()}**: {found.why}" if found is not None else ""
        set_value(self._truth, f"{self._text()}{judged}")
        stated = tuple(f"{source}: {text}" for source, text in scene.conditions if source in ("relation", "goal"))
        if self._stated.options != (stated or (NONE,)):
            self._stated.options = stated or (NONE,)

    def _text(self) -> str:
        """Return the predicate that the controls describe."""
        arguments = [handle.value for handle in self._arguments if handle.value != NONE]
        return f"{self._predicate.value}({', '.join(arguments)})"

    def _add(self) -> None:
        text = self._text()
        self.window.submit(AddGoal(text) if self._target.value == GOAL else AddRelation(text))

    def _remove(self) -> None:
        source, _, text = self._stated.value.partition(": ")
        if text:
            self.window.submit(RemoveGoal(text) if source == "goal" else RemoveRelation(text))


def fitting_names(scene: StudioScene, kind: str) -> tuple[str, ...]:
    """Return the names that can be an argument of a kind, such as ``thing`` or ``joint``."""
    objects = scene.objects
    parts = [f"{o.name}.{link.name}" for o in objects.values() for link in o.links[1:]]
    joints = [f"{o.name}.{j.name}" for o in objects.values() for j in o.joints if j.has_axis]
    robots = list(scene.spec.robots)
    offered: dict[str, list[str]] = {
        "thing": [*objects, *parts],
        "body": [*objects, *parts, *robots],
        "joint": [*joints, *dict.fromkeys(name.partition(".")[0] for name in joints)],
        "robot": robots,
    }
    return tuple(offered.get(kind, ()))


def _row(scene: StudioScene, source: str, text: str, state: SceneState | None) -> str:
    found: Any = verdict(scene, text, state)
    try:
        unit = parse_call(text).declaration.unit
    except ExpressionError:
        unit = ""
    truth = NONE if found is None else "true" if found.value else "false"
    color = "#888" if found is None else "#1a8f3c" if found.value else "#c22"
    margin = "" if found is None else f"{found.margin:+.3g} {unit}"
    why = "it cannot be judged before a robot moves" if found is None else found.why
    cells = (html.escape(source), html.escape(text), f'<b style="color:{color}">{truth}</b>', html.escape(margin))
    return f'<tr title="{html.escape(why, quote=True)}">{"".join(f"<td>{cell}&nbsp;</td>" for cell in cells)}</tr>'
