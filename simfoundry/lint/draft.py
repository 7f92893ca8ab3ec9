"""Draft scenes for lints, and the evaluation of conditions in their initial states.

A draft is lowered by the same passes as a compiled scene, but without the expensive decomposition of meshes into convex
parts. Instead, the draft uses the cached parts of a mesh if there are any, or else its convex hull. If only the hull of
an object is known, lints report findings about the object, and about objects placed on or in it, only if the findings
are certain.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from simfoundry.assets.cache import Cache
from simfoundry.geometry.frames import IDENTITY, Array, frozen_array
from simfoundry.geometry.hulls import Hulls
from simfoundry.predicates.judging.bodies import Bodies, NoCavityError, PredicateError
from simfoundry.predicates.judging.distances import Distances
from simfoundry.predicates.judging.judge import Judge
from simfoundry.predicates.judging.view import StateBatch, View
from simfoundry.scene.cameras import lower_cameras
from simfoundry.scene.earlier import EarlierLowering
from simfoundry.scene.lower import OBJECT_PASSES, Lowering, lower_surroundings
from simfoundry.scene.model import Camera, Link, Scene, SceneObject
from simfoundry.scene.object_shapes import hulls
from simfoundry.scene.objects import ObjectLowering
from simfoundry.scene.state import SceneState
from simfoundry.spec.diagnostics import Diagnostic, SpecError
from simfoundry.spec.files import Loaded
from simfoundry.spec.models.asset import AssetSpec
from simfoundry.spec.models.base import FARTHEST
from simfoundry.spec.models.predicate import Call, parse_call, parts
from simfoundry.spec.models.scene import ObjectSpec, SceneSpec

if TYPE_CHECKING:
    from simfoundry.scene.task_start import Starts
    from simfoundry.spec.models.task import Start


@dataclass(frozen=True, eq=False)
class DraftScene:
    """A draft scene without robots.

    Attributes:
        spec: The scene document, including the changes that the initial state of a task makes to it.
        scene: The lowered scene.
        approximate: Names of the objects for which only the convex hulls are known.
        unplaced: Names of the objects whose poses are uncertain.
        lowered: The objects before they were placed, by name, as far as a later draft can reuse them.
    """

    spec: SceneSpec
    scene: Scene
    approximate: frozenset[str]
    unplaced: frozenset[str]
    lowered: Mapping[str, SceneObject] = field(default_factory=dict)

    @cached_property
    def shapes(self) -> dict[str, Hulls]:
        """Convex parts, in the world frame, of each object that has a known pose and a usable size."""
        found = {o.name: hulls(o) for o in self.scene.objects if o.name not in self.unplaced}
        return {name: shape for name, shape in found.items() if len(shape.corners) and _is_usable(shape)}

    @cached_property
    def bounds(self) -> dict[str, tuple[Array, Array]]:
        """Minimum and maximum corners of each object's bounding box [m], as two arrays of shape (3,)."""
        return {name: shape.bounds() for name, shape in self.shapes.items()}

    @cached_property
    def solids(self) -> list[SceneObject]:
        """Objects in :attr:`shapes` that have colliders."""
        items = (self.scene.by_name[name] for name in self.shapes)
        return [item for item in items if any(link.colliders for link in item.links)]

    @cached_property
    def cameras(self) -> dict[str, Camera]:
        """Cameras with their world poses, except those that are mounted on a robot."""
        from simfoundry.scene.kinematics import link_poses

        found = {camera.name: camera for camera in self.scene.cameras}
        for mounted in self.scene.mounted:
            item = self.scene.by_name[mounted.carrier]
            X_WL = item.X_WO @ link_poses(item)[mounted.link or item.root.name]
            found[mounted.camera.name] = replace(mounted.camera, X_WC=X_WL @ mounted.camera.X_WC)
        return {name: found[name] for name in self.spec.cameras if name in found}

    def distance(self, a: str, b: str, threshold: float) -> float:
        """Return an approximate signed distance [m] between two objects.

        The result is always on the same side of ``threshold`` as the exact distance.
        """
        things = self._bodies.thing(a), self._bodies.thing(b)
        return float(self._distances.between(self._view, *things, threshold)[0])

    def overlap(self, a: str, b: str) -> float:
        """Return the penetration depth [m] of two objects."""
        things = self._bodies.thing(a), self._bodies.thing(b)
        return -float(Distances(self._bodies).between(self._view, *things)[0])

    @cached_property
    def _bodies(self) -> Bodies:
        return Bodies(self.scene)

    @cached_property
    def _view(self) -> View:
        return View(self._bodies, StateBatch(1, {}))

    @cached_property
    def _distances(self) -> Distances:
        return Distances(self._bodies, bounds_first=True)


def _is_usable(shape: Hulls) -> bool:
    return bool(np.abs(shape.corners).max() + shape.radius.max() < FARTHEST)


def drafted_start(
    loaded: Loaded,
    checkpoint: Callable[[], None] = lambda: None,
    earlier: DraftScene | None = None,
    shown: bool = False,
) -> DraftScene | None:
    """Return the draft of a scene document or of the initial state of a task; see :func:`drafted`.

    Returns:
        The draft, or None if the scene could not be read.

    Raises:
        SpecError: If lowering fails.
    """
    if isinstance(loaded.spec, SceneSpec):
        return drafted(loaded, (), checkpoint, earlier, shown)
    from simfoundry.spec.models.task import TaskSpec

    assert isinstance(loaded.spec, TaskSpec)
    scene = loaded.used(loaded.spec.scene)
    return (
        None
        if scene is None or not isinstance(scene.spec, SceneSpec)
        else drafted(scene, [loaded.spec.start], checkpoint, earlier, shown)
    )


def drafted(
    loaded: Loaded,
    starts: Sequence[Start] = (),
    checkpoint: Callable[[], None] = lambda: None,
    earlier: DraftScene | None = None,
    shown: bool = False,
) -> DraftScene:
    """Return the draft of a scene document after applying the changes in ``starts``, in order.

    ``checkpoint`` is called before each object is lowered. It can raise an exception to stop. Objects that have not
    changed are taken from an ``earlier`` draft of the same document. If ``shown`` is set, the draft has the same
    visuals as a build.

    Raises:
        SpecError: If lowering fails.
    """
    assert isinstance(loaded.spec, SceneSpec)
    spec = loaded.spec
    if starts:
        from simfoundry.spec.models.task import with_starts

        spec = with_starts(spec, starts)
    lowering = Lowering(replace(loaded, spec=spec), Cache.default(), lambda *_: checkpoint(), fetch=False, draft=True)
    lowering.shown = shown
    if earlier is not None:
        lowering.earlier = EarlierLowering(earlier.spec, earlier.scene.viewer, earlier.lowered, earlier.scene.by_name)
    scene = lowering.run((*OBJECT_PASSES, lower_cameras))
    lowered = lowering.lowered if loaded.reuse is None else {}  # the category of a copy is that of what it repeats
    return DraftScene(spec, scene, frozenset(lowering.approximate), frozenset(lowering.unplaced), lowered)


def pictured(loaded: Loaded, starts: Sequence[Start] = ()) -> Scene:
    """Return a draft of a scene document that looks like a build, apart from robots and the background.

    Raises:
        SpecError: If lowering fails.
    """
    assert isinstance(loaded.spec, SceneSpec)
    spec = loaded.spec
    if starts:
        from simfoundry.spec.models.task import with_starts

        spec = with_starts(spec, starts)
    spec = spec.model_copy(update={"background": None})
    lowering = Lowering(replace(loaded, spec=spec), Cache.default(), fetch=False, draft=True, shown=True)
    return lowering.run((*OBJECT_PASSES, lower_cameras, lower_surroundings))


def pictured_asset(loaded: Loaded) -> Scene:
    """Return a scene with an asset document's object alone, fixed at the origin, with its joints at zero.

    Raises:
        SpecError: If lowering fails.
    """
    assert isinstance(loaded.spec, AssetSpec)
    work, name = ObjectLowering(loaded, Cache.default(), draft=True, shown=True), loaded.spec.name
    links, joints = work.articulated(loaded, loaded.spec, ObjectSpec(asset=loaded.path.name), name)
    if work.findings:
        raise SpecError(work.findings)
    item = SceneObject(name, loaded.spec.category or name, True, IDENTITY, tuple(links), joints)
    return Scene(name, frozen_array((0.0, 0.0, -9.81)), (item,))


def drafted_links(loaded: Loaded) -> tuple[tuple[Link, ...], list[Diagnostic]]:
    """Return the links of an asset document that could be lowered, and the errors of the others."""
    assert isinstance(loaded.spec, AssetSpec)
    work = ObjectLowering(loaded, Cache.default(), draft=True)
    links, _ = work.articulated(loaded, loaded.spec, ObjectSpec(asset=loaded.path.name), loaded.spec.name)
    return tuple(links), work.findings


def drafted_steps(
    loaded: Loaded, checkpoint: Callable[[], None] = lambda: None
) -> tuple[dict[str, DraftScene], list[Diagnostic]]:
    """Return the drafts of the steps of a task that have their own initial state, and the errors of the others."""
    from simfoundry.spec.models.task import TaskSpec

    assert isinstance(loaded.spec, TaskSpec)
    scene = loaded.used(loaded.spec.scene)
    found, errors = dict[str, DraftScene](), list[Diagnostic]()
    for name, step in loaded.spec.subtasks.items() if scene is not None else ():
        if step.start is None or scene is None:
            continue
        try:
            found[name] = drafted(scene, [loaded.spec.start, step.start], checkpoint)
        except SpecError as error:
            starts = {("start",): loaded.spec.start, ("subtasks", name, "start"): step.start}
            errors += own_findings(loaded, error, starts)
    return found, errors


def own_findings(loaded: Loaded, error: SpecError, starts: Starts | None = None) -> list[Diagnostic]:
    """Return the errors in a document and in its bases. Those in documents that it uses are reported there.

    Errors that are caused by ``starts``, the initial states of a task by path, are moved to the task.
    """
    findings = error.diagnostics
    if starts is not None:
        from simfoundry.scene.task_start import placed_in_task
        from simfoundry.spec.models.task import TaskSpec, with_starts

        assert isinstance(loaded.spec, TaskSpec)
        scene = loaded.used(loaded.spec.scene)
        assert scene is not None and isinstance(scene.spec, SceneSpec)
        spec = with_starts(scene.spec, starts.values())
        findings = [placed_in_task(loaded, starts, spec, d) for d in findings]
    elsewhere = {Path(file).absolute() for used in loaded.uses.values() for file in used.files()}
    return [d for d in findings if Path(d.document).absolute() not in elsewhere]


# Predicates that depend only on extents and poses, so that an object's hull gives the same result as its parts.
HULL_DECIDES = ("LeftOf", "RightOf", "Behind", "InFrontOf", "NextTo", "At", "Upright", "Open", "Closed")

# Predicates on two objects that are always false if the hulls of the objects do not touch.
NEEDS_TOUCH = ("OnTop", "Inside", "Touching")


class StartJudge:
    """A judge of conditions in the initial state of a scene, before any robot has moved."""

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
        """Return True if a condition holds, False if it does not hold, or None if the result is uncertain."""
        tag, below = parts(condition)
        if tag == "text":
            return self._call_value(parse_call(below[0]))
        values = [self.value(item) for item in below]
        if tag == "not":
            return None if values[0] is None else not values[0]
        decisive = tag == "any"  # one true operand decides `any`, and one false operand decides `all`
        if decisive in values:
            return decisive
        return None if None in values or not values else not decisive

    def explanation(self, condition: Any) -> str:
        """Explain the value of a condition, including measured quantities. The value must be certain."""
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

    def margin(self, text: str) -> float | None:
        """Return the margin of a predicate in its unit, or None if it is not measured. Its value must be certain."""
        call = parse_call(text)
        if call.declaration.before_motion is not None or self._is_apart(call):
            return None
        try:
            return self._measure(str(call), self._state).margin
        except PredicateError:
            return None

    def missing_cavity(self, call: Call) -> str:
        """Explain that a predicate needs a cavity that its object lacks, or return an empty string."""
        names = {arg.partition(".")[0] for arg, kind in zip(call.args, call.kinds, strict=True) if kind != "number"}
        if not names <= self._draft.shapes.keys() or names & self._draft.approximate:
            return ""
        try:
            self._decide(str(call), self._state)
        except NoCavityError as error:
            return str(error)
        except PredicateError:
            return ""
        return ""

    def _call_value(self, call: Call) -> bool | None:
        names = {arg.partition(".")[0] for arg, kind in zip(call.args, call.kinds, strict=True) if kind != "number"}
        if call.declaration.before_motion is not None:
            return call.declaration.before_motion if call.args[0].partition(".")[0] in self._draft.shapes else None
        if not names <= self._draft.shapes.keys():
            return None
        if call.predicate not in HULL_DECIDES and self._draft.approximate:
            if self._is_apart(call):
                return False
            if names & self._draft.approximate or call.predicate == "OnTop":  # other objects may add support
                return None
        return self._judged(call)

    def _is_apart(self, call: Call) -> bool:
        """Return True if a predicate's two objects are certain not to touch because their hulls do not touch."""
        approximate = {arg.partition(".")[0] for arg in call.args} & self._draft.approximate
        may_be_apart = bool(approximate) and call.predicate in NEEDS_TOUCH
        return may_be_apart and self._judged(Call("Touching", call.args)) is False

    def _judged(self, call: Call) -> bool | None:
        try:
            return self._decide(str(call), self._state).value
        except NoCavityError:
            return False
        except PredicateError:
            return None
