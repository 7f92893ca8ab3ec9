"""Evaluation of conditions in one state or in many states at once, including values, margins and explanations."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import cached_property
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from simfoundry.geometry.frames import Array, Index
from simfoundry.predicates.judging.bodies import Bodies, Entity, PredicateError
from simfoundry.predicates.judging.distances import Distances
from simfoundry.predicates.judging.fingers import Fingers, fingers, grip_margin
from simfoundry.predicates.judging.thresholds import SCORE_SCALES, SCORE_SPEED, SETTLED
from simfoundry.predicates.judging.view import StateBatch, View
from simfoundry.scene.lengths import length
from simfoundry.scene.model import Scene
from simfoundry.scene.state import SceneState
from simfoundry.spec.models.base import Model
from simfoundry.spec.models.predicate import PREDICATES, Call, parse_call, parts

# Function that explains a term, given its value and whether it holds; the explanation may be empty.
Explain = Callable[[float, bool], str]


class Context:
    """Measurements that are prepared once for each scene and reused for all conditions."""

    def __init__(self, bodies: Bodies, bounds_first: bool = False) -> None:
        self.bodies = bodies
        self.distances = Distances(bodies, bounds_first)

    @cached_property
    def hands(self) -> dict[str, Fingers]:
        """The fingers of all robots that have a gripper, keyed by robot name."""
        found = {name: fingers(self.bodies, name) for name in self.bodies.robots}
        return {name: hand for name, hand in found.items() if hand is not None}

    @cached_property
    def start(self) -> View:
        """The initial state of the scene, as a batch of one state."""
        return View(self.bodies, StateBatch(1, {}))

    def others(self, *things: Entity) -> list[Entity]:
        """Return all objects that have a shape, except those that contain an entity in ``things``."""
        owners = {thing.owner for thing in things}
        names = (name for name in self.bodies.objects if name not in owners)
        return [self.bodies.thing(name) for name in names if any(self.bodies[name].forms)]


class Term(NamedTuple):
    """A quantity that contributes to the decision, with its ``value`` and its ``margin`` in n states.

    Both are NaN in states in which an earlier term was decisive. The score is one half at the margin ``scale``.
    """

    value: Array
    margin: Array
    explain: Explain
    scale: float

    def text(self, k: int) -> str:
        """Return the explanation of the term in the k-th state."""
        return self.explain(float(self.value[k]), bool(self.margin[k] > 0))


class Terms:
    """The terms of one predicate for the states in ``view``, in the order in which the predicate's rule adds them.

    For scores, ``scale`` is the predicate's scale, and ``for_score`` is True: terms that require rest then do not
    prevent later terms from being measured, so that an object on its way has a distance from its goal.
    """

    def __init__(self, context: Context, view: View, scale: float = 1.0, for_score: bool = False) -> None:
        self.context, self.view, self._scale, self._for_score = context, view, scale, for_score
        self.terms: list[Term] = []
        self.margin: Array = np.full(view.n, np.inf)
        self._open: Array = np.full(view.n, np.inf)  # positive where later terms are measured

    @property
    def score(self) -> Array:
        """The scores of the states, shape (n,)."""
        known = [score_of(np.where(np.isnan(t.margin), np.inf, t.margin), t.scale) for t in self.terms]
        return np.asarray(np.min([*known, np.ones(self.view.n)], axis=0))

    def require(
        self, value: Array, margin: Array, explain: Explain, scale: float | None = None, is_decisive: bool = True
    ) -> None:
        """Add a term whose value is known in every state.

        Args:
            value: The values.
            margin: The margins, which are positive where the term is satisfied.
            explain: A function that explains a value.
            scale: The margin at which the score of the term is one half. By default, that of the predicate.
            is_decisive: If False, later terms are measured for scores even where this term is not satisfied.
        """
        self.terms.append(Term(value, margin, explain, self._scale if scale is None else scale))
        self.margin = np.minimum(self.margin, margin)
        if is_decisive or not self._for_score:
            self._open = np.minimum(self._open, margin)

    def require_if_open(
        self, measure: Callable[[View], Array], margin: Callable[[Array], Array], explain: Explain
    ) -> None:
        """Add a term that is slow to measure. It is evaluated only in states in which all previous terms hold.

        ``measure`` returns the values in these states, and ``margin`` converts values to margins.
        """
        value, margins = np.full(self.view.n, np.nan), np.full(self.view.n, np.nan)
        left = np.flatnonzero(self._open > 0)
        if len(left):
            value[left] = measure(self.view if len(left) == self.view.n else self.view.at(left))
            margins[left] = margin(value[left])
            self.margin[left] = np.minimum(self.margin[left], margins[left])
            self._open[left] = np.minimum(self._open[left], margins[left])
        self.terms.append(Term(value, margins, explain, self._scale))

    def require_at_rest(self, a: Entity) -> None:
        """Require that the object to which ``a`` belongs does not move faster than :data:`SETTLED`."""
        speed = self.view.batch.speeds.get(a.owner, np.zeros(self.view.n))
        self.require(
            speed,
            SETTLED - speed,
            lambda v, ok: "" if ok else f"`{a.name}` moves at {100 * v:.1f} cm/s",
            scale=SCORE_SPEED,
            is_decisive=False,
        )

    def require_not_held(self, a: Entity) -> None:
        """Require that no gripper holds ``a``."""
        if self.context.bodies.robots:
            self.require_if_open(
                lambda view: grip_margin(view, self.context.distances, self.context.hands.values(), a),
                lambda v: -v,
                lambda v, ok: "" if ok else f"a robot holds `{a.name}`",
            )

    def gap_text(self, a: Entity, b: Entity, value: float) -> str:
        """Return an explanation of the distance [m] between two entities."""
        if not np.isfinite(value):
            return f"`{a.name}` or `{b.name}` has no colliders"
        return f"`{a.name}` is {length(value)} away from `{b.name}`" if value > 0 else f"`{a.name}` touches `{b.name}`"

    def explanation(self, k: int) -> str:
        """Explain the terms that fail in the k-th state, or all terms if none of them fails."""
        known = [term for term in self.terms if not np.isnan(term.margin[k])]
        failed = [term for term in known if not term.margin[k] > 0]
        return "; ".join(text for term in failed or known if (text := term.text(k)))


def score_of(margin: Array, scale: float) -> Array:
    """Map margins to scores between -1 and 1, which increase strictly and are one half at the margin ``scale``."""
    size = np.abs(margin)
    with np.errstate(invalid="ignore"):
        return np.asarray(np.where(np.isinf(margin), np.sign(margin), margin / (size + scale)))


# Number of states evaluated at once, chosen so that their arrays fit in the processor's cache.
CHUNK = 4096


class Verdict(NamedTuple):
    """The value of a condition, its margin in the predicate's unit (positive if it holds), and an explanation."""

    value: bool
    margin: float
    why: str


class Judge:
    """An evaluator of conditions on states of one scene, which reuses preprocessed scene data.

    A condition is text such as ``"OnTop(cup, desk)"``, or a combination of conditions with ``all``, ``any`` and
    ``not``, given as plain data or as the models in :mod:`simfoundry.spec.models.predicate`.

    If ``bounds_first`` is set, the values are the same, but margins and explanations may contain bounds instead of
    distances, and MuJoCo is loaded only if the bounds are inconclusive.

    Raises:
        ExpressionError: If a condition is invalid.
        PredicateError: If a condition cannot be evaluated in this scene.
    """

    def __init__(self, scene: Scene, bounds_first: bool = False) -> None:
        self.scene = scene
        self._context = Context(Bodies(scene), bounds_first)
        self._calls: dict[str, tuple[str, Callable[..., None], list[Any]]] = {}
        self._singles: dict[bool, tuple[SceneState, View]] = {}

    def __call__(self, condition: Any, state: SceneState) -> Verdict:
        """Evaluate a condition in a single state."""
        value, margin, why = self._judged(condition, self._view_of(state))
        return Verdict(bool(value[0]), float(margin[0]), why(0))

    def _view_of(self, state: SceneState, exact: bool = False) -> View:
        known = self._singles.get(exact)
        if known is None or known[0] is not state:  # conditions often follow on the same state
            known = state, View(self._context.bodies, StateBatch.of(self.scene, [state]), exact)
            self._singles[exact] = known
        return known[1]

    def score(self, condition: Any, state: SceneState) -> float:
        """Return how well a condition holds in a single state, from -1 to 1. It holds where the score is positive.

        The score of a predicate is the smallest score of its terms. A term with the margin m has the score m / (|m| +
        s), where s is the scale of the term. The score of ``all`` is the smallest score of its parts, that of ``any``
        the largest, and ``not`` negates the score.
        """
        tag, below = parts(condition)
        if tag == "text":
            view = self._view_of(state, exact=True)
            call = parse_call(condition)
            scale = call.declaration.scale or SCORE_SCALES.get(call.declaration.unit, 1.0)
            return float(self._terms(condition, Terms(self._context, view, scale, for_score=True)).score[0])
        if not below:
            return self(condition, state).margin  # raises the error for an empty condition
        scores = [self.score(one, state) for one in below]
        return -scores[0] if tag == "not" else min(scores) if tag == "all" else max(scores)

    def batch(self, condition: Any, batch: StateBatch) -> tuple[NDArray[np.bool_], Array]:
        """Return the values and margins of a condition in n states, as arrays of shape (n,)."""
        values, margins = np.zeros(batch.n, bool), np.zeros(batch.n)
        for index, view in self._views(batch):
            values[index], margins[index], _ = self._judged(condition, view)
        return values, margins

    def _views(self, batch: StateBatch) -> Iterator[tuple[Index, View]]:
        """Yield views of at most :data:`CHUNK` states, along with the indices of these states."""
        for start in range(0, batch.n, CHUNK):
            index = np.arange(start, min(start + CHUNK, batch.n))
            yield index, View(self._context.bodies, batch if len(index) == batch.n else batch.at(index))

    def holds(self, conditions: Mapping[str, Any], batch: StateBatch) -> dict[str, NDArray[np.bool_]]:
        """Return the values of several named conditions in n states, as arrays of shape (n,).

        This is faster than calling :meth:`batch` for each condition because the conditions share poses and verdicts. A
        part of a condition is only evaluated if the preceding parts are inconclusive in at least one state.
        """
        found = {name: np.zeros(batch.n, bool) for name in conditions}
        for index, view in self._views(batch):
            known: dict[str, NDArray[np.bool_]] = {}
            for name, condition in conditions.items():
                found[name][index] = self._value(condition, view, known)
        return found

    def _value(self, condition: Any, view: View, known: dict[str, NDArray[np.bool_]]) -> NDArray[np.bool_]:
        """Return the values of a condition.

        ``known`` caches the values of predicates that have been evaluated, keyed by text.
        """
        tag, below = parts(condition)
        if tag == "text":
            if condition not in known:
                known[condition] = self._judged(condition, view).value
            return known[condition]
        if tag == "not" or not below:
            return ~self._value(below[0], view, known) if below else self._judged(condition, view).value
        decisive = tag == "any"
        value = np.full(view.n, not decisive)
        for part in below:
            found = self._value(part, view, known)
            value = value | found if decisive else value & found
            if (value == decisive).all():
                break
        return value

    def _arguments(self, call: Call) -> list[Any]:
        """Convert the arguments of a call to the types that its rule expects: entities, joints and numbers."""
        bodies = self._context.bodies
        read: dict[str, Callable[[str], Any]] = {"joint": bodies.joints, "number": float}
        found = [read.get(kind, bodies.thing)(arg) for arg, kind in zip(call.args, call.kinds, strict=True)]
        things = [arg for arg, kind in zip(found, call.kinds, strict=True) if kind in ("thing", "body")]
        for a, b in combinations(things, 2):
            if a.owner == b.owner and set(a.links) & set(b.links):
                raise PredicateError(f"`{call}` refers to the same object twice")
        return found

    def _terms(self, condition: str, terms: Terms) -> Terms:
        """Add the terms of a predicate that is applied to arguments."""
        if condition not in self._calls:
            call = parse_call(condition)
            self._calls[condition] = call.predicate, call.declaration.rule, self._arguments(call)
        name, rule, arguments = self._calls[condition]
        with PREDICATES.running(name):
            rule(terms, *arguments)
        return terms

    def _judged(self, condition: Any, view: View) -> _Judged:
        tag, below = parts(condition)
        known = condition.keys() == {tag} if isinstance(condition, dict) else isinstance(condition, str | Model)
        if not known:
            kinds = "a predicate, such as `OnTop(cup, desk)`, or a mapping with one of the keys `all`, `any` and `not`"
            raise PredicateError(f"`{condition}` is not a condition; write {kinds}")
        if tag == "text":
            terms = self._terms(condition, Terms(self._context, view))
            name = self._calls[condition][0]
            return _Judged(terms.margin > 0, terms.margin, lambda k: PREDICATES.running(name)(terms.explanation)(k))
        if not below:
            always = "true" if tag == "all" else "false"
            raise PredicateError(f"`{tag}` without conditions is invalid: it would always be {always}")
        judged = [self._judged(one, view) for one in below]
        if tag == "not":
            return _Judged(~judged[0].value, -judged[0].margin, judged[0].why)

        def why(k: int) -> str:
            """Explain the conditions that decide the value in the k-th state, or all of them if none is decisive."""
            deciding = [j for j in judged if bool(j.value[k]) is (tag == "any")]
            return "; ".join(text for j in deciding or judged if (text := j.why(k)))

        values, margins = np.stack([j.value for j in judged]), np.stack([j.margin for j in judged])
        if tag == "all":
            return _Judged(np.asarray(values.all(axis=0)), margins.min(axis=0), why)
        return _Judged(np.asarray(values.any(axis=0)), margins.max(axis=0), why)


class _Judged(NamedTuple):
    value: NDArray[np.bool_]
    margin: Array
    why: Callable[[int], str]
