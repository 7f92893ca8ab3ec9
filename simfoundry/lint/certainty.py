"""Judge conditions at the start of a scene; undecided if a draft does not have enough information."""

from __future__ import annotations

from functools import cached_property
from typing import Any

from simfoundry.lint.draft import DraftScene
from simfoundry.predicates.judging.bodies import NoCavityError, PredicateError
from simfoundry.predicates.judging.judge import Judge
from simfoundry.scene.state import SceneState
from simfoundry.spec.models.predicate import Call, parse_call, parts

HULL_DECIDES = ("LeftOf", "RightOf", "Behind", "InFrontOf", "NextTo", "At", "Upright", "Open", "Closed")
"""Predicates that measure only extents and poses: the hull of an object gives the same result as its parts."""

NEEDS_TOUCH = ("OnTop", "Inside", "Touching")
"""Predicates of two objects that are false if not even the hulls of the two touch."""


class StartJudge:
    """Judges conditions in the initial state of a scene, before any robot has moved."""

    def __init__(self, draft: DraftScene) -> None:
        self._draft = draft
        self._state = SceneState.initial(draft.scene)

    @cached_property
    def _decide(self) -> Judge:
        return Judge(self._draft.scene, bounds_first=True)

    @cached_property
    def _measure(self) -> Judge:
        return Judge(self._draft.scene)

    def value(self, condition: Any) -> bool | None:
        """Return whether a condition holds; None if that is uncertain."""
        tag, below = parts(condition)
        if tag == "text":
            return self._call_value(parse_call(below[0]))
        values = [self.value(item) for item in below]
        if tag == "not":
            return None if values[0] is None else not values[0]
        decisive = tag == "any"  # one true part decides `any`, one false part decides `all`
        if decisive in values:
            return decisive
        return None if None in values or not values else not decisive

    def explanation(self, condition: Any) -> str:
        """Return the reasons, with numbers, for the value of a condition that is certain."""
        tag, below = parts(condition)
        if tag == "text":
            call = parse_call(below[0])
            if call.declaration.before_motion is not None:
                return f"no robot has moved yet, so `{call}` is {str(call.declaration.before_motion).lower()}"
            if self._is_apart(call):
                call = Call("Touching", call.args)
            try:
                return self._measure(str(call), self._state).why
            except NoCavityError as error:
                return str(error)
        value = self.value(condition)
        decisive = [item for item in below if self.value(item) is (value if tag != "not" else not value)]
        return "; ".join(why for item in decisive if (why := self.explanation(item)))

    def _call_value(self, call: Call) -> bool | None:
        names = {arg.partition(".")[0] for arg, kind in zip(call.args, call.kinds, strict=True) if kind != "number"}
        if call.declaration.before_motion is not None:
            return call.declaration.before_motion if call.args[0].partition(".")[0] in self._draft.shapes else None
        if not names <= self._draft.shapes.keys():
            return None
        if call.predicate not in HULL_DECIDES and self._draft.approximate:
            if self._is_apart(call):
                return False
            if names & self._draft.approximate or call.predicate == "OnTop":  # other objects may help to support it
                return None
        return self._judged(call)

    def _is_apart(self, call: Call) -> bool:
        """Return True if the hulls of the two objects of a predicate do not touch."""
        approximate = {arg.partition(".")[0] for arg in call.args} & self._draft.approximate
        return (
            bool(approximate) and call.predicate in NEEDS_TOUCH and self._judged(Call("Touching", call.args)) is False
        )

    def _judged(self, call: Call) -> bool | None:
        try:
            return self._decide(str(call), self._state).value
        except NoCavityError:
            return False
        except PredicateError:
            return None
