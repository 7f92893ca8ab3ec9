"""Add and remove relations of a scene, and conditions of the goal of a task."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from simfoundry.spec.change.merge.conflict import ABSENT
from simfoundry.spec.models.predicate import ExpressionError, parse_call, parts
from simfoundry.studio.acts.act import ActEdits, ActError, scene_edits, task_edits
from simfoundry.studio.reading import StudioScene


@dataclass(frozen=True)
class AddRelation:
    """State a relation, such as ``OnTop(mug, desk)``, that should hold in the scene."""

    text: str

    @property
    def label(self) -> str:
        """Return a short description."""
        return f"add {self.text}"

    def edits(self, scene: StudioScene) -> ActEdits:
        """Return the edit of the relations."""
        call = _parsed(self.text)
        if call in map(_spelled, scene.spec.relations):
            raise ActError(f"the scene already states {call}")
        return scene_edits(scene, {("relations",): (*scene.spec.relations, call)})


@dataclass(frozen=True)
class RemoveRelation:
    """Remove a relation of the scene."""

    text: str

    @property
    def label(self) -> str:
        """Return a short description."""
        return f"remove {self.text}"

    def edits(self, scene: StudioScene) -> ActEdits:
        """Return the edit of the relations."""
        kept = tuple(text for text in scene.spec.relations if _spelled(text) != _spelled(self.text))
        if len(kept) == len(scene.spec.relations):
            raise ActError(f"the scene does not state {self.text}")
        return scene_edits(scene, {("relations",): kept or ABSENT})


@dataclass(frozen=True)
class AddGoal:
    """Require one more condition in the goal of the task."""

    text: str

    @property
    def label(self) -> str:
        """Return a short description."""
        return f"add {self.text} to the goal"

    def edits(self, scene: StudioScene) -> ActEdits:
        """Return the edit of the goal, whose conditions must all hold."""
        call, goal = _parsed(self.text), _goal(scene)
        tag, below = parts(goal)
        if call in [_spelled(each) for each in below if isinstance(each, str)]:
            raise ActError(f"the goal already requires {call}")
        new = {"all": (*below, call)} if tag == "all" else {"all": (goal, call)}
        return task_edits(scene, {("goal",): new})


@dataclass(frozen=True)
class RemoveGoal:
    """Remove a predicate from the goal of the task, wherever it is in it."""

    text: str

    @property
    def label(self) -> str:
        """Return a short description."""
        return f"remove {self.text} from the goal"

    def edits(self, scene: StudioScene) -> ActEdits:
        """Return the edit of the goal."""
        goal = _goal(scene)
        kept = _without(goal, _spelled(self.text))
        if kept is None:
            raise ActError("a task needs a goal; add another condition before you remove the last one")
        if kept == goal:
            raise ActError(f"the goal does not contain {self.text}")
        return task_edits(scene, {("goal",): kept})


def _goal(scene: StudioScene) -> Any:
    """Return the goal as plain data."""
    assert scene.root.document is not None
    return scene.root.document.data.get("goal", ())


def _without(condition: Any, text: str) -> Any:
    """Return a condition without a predicate, or None if nothing is left of it."""
    tag, below = parts(condition)
    if tag == "text":
        return None if isinstance(condition, str) and _spelled(condition) == text else condition
    kept = tuple(each for each in (_without(item, text) for item in below) if each is not None)
    if kept == below:
        return condition
    if not kept:
        return None
    if tag == "not":
        return {"not": kept[0]}
    return kept[0] if len(kept) == 1 else {tag: kept}


def _spelled(text: str) -> str:
    """Return a predicate in its usual spelling, or the text itself if it is none."""
    try:
        return str(parse_call(text))
    except ExpressionError:
        return text


def _parsed(text: str) -> str:
    try:
        return str(parse_call(text))
    except ExpressionError as error:
        raise ActError(str(error)) from None
