"""Scenes as tasks start: the `start` of a task, and on top of it that of a step, applied to the scene's document."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

from simfoundry.assets.cache import Cache
from simfoundry.scene.lower import lower
from simfoundry.scene.model import Scene
from simfoundry.spec.change.start import with_starts
from simfoundry.spec.diagnostics import Diagnostic, SpecError
from simfoundry.spec.loaded import Loaded
from simfoundry.spec.models.expressions import parse_call
from simfoundry.spec.models.scene import ObjectSpec, SceneSpec
from simfoundry.spec.models.task import Start, TaskSpec


@dataclass(frozen=True, eq=False)
class TaskSetup:
    """The documents of a ``task`` and its ``scene``, and the ``step`` that it starts with, empty for the first."""

    task: Loaded
    scene: Loaded
    step: str = ""
    cache: Cache | None = None

    @property
    def task_spec(self) -> TaskSpec:
        """The task as its document has it."""
        assert isinstance(self.task.spec, TaskSpec)
        return self.task.spec

    @property
    def scene_spec(self) -> SceneSpec:
        """The scene as its document has it."""
        assert isinstance(self.scene.spec, SceneSpec)
        return self.scene.spec

    def with_step(self, name: str) -> TaskSetup:
        """The same documents, started as a step starts."""
        return replace(self, step=name)

    @property
    def put_by_step(self) -> frozenset[str]:
        """The objects that the step's own start puts somewhere."""
        start = self.task_spec.subtasks[self.step].start if self.step else None
        return frozenset((*start.place, *start.pose)) if start is not None else frozenset()

    def starts(self) -> Iterator[tuple[tuple[str, ...], Start]]:
        """The differences from the scene, later ones on top of earlier ones, each with its path in the task."""
        yield ("start",), self.task_spec.start
        own = self.task_spec.subtasks[self.step].start if self.step else None
        if own is not None:
            yield ("subtasks", self.step, "start"), own


def lowered(setup: TaskSetup) -> Scene:
    """The scene as the task starts; raises :class:`SpecError`, with places in the task where its start is to blame."""
    spec = started(setup)
    try:
        return lower(replace(setup.scene, spec=spec), setup.cache)
    except SpecError as error:
        raise SpecError([_placed_in_task(setup, d) for d in error.diagnostics]) from None


def started(setup: TaskSetup) -> SceneSpec:
    """The scene's document with what the starts change; relations that they undo are gone."""
    spec = with_starts(setup.scene_spec, (start for _, start in setup.starts()))
    moved, turned = set[str](), set[str]()
    for _, start in setup.starts():
        moved |= {*start.place, *start.pose}
        turned |= {*start.joints}
    objects = spec.objects
    kept = [text for text in setup.scene_spec.relations if not _is_undone(text, moved, turned)]
    stood = [f"OnTop({name}, {_carrier(objects[name])})" for name in sorted(moved) if _carrier(objects[name])]
    return spec.model_copy(update={"relations": (*kept, *stood)})


def carried_by(setup: TaskSetup) -> dict[str, str]:
    """The object that each object stands on or in, as far as the documents say so."""
    spec = started(setup)
    found = {}
    for text in spec.relations:
        call = parse_call(text)
        if call.predicate in ("OnTop", "Inside"):
            found[call.args[0]] = call.args[1].partition(".")[0]
    return found | {name: carrier for name, item in spec.objects.items() if (carrier := _carrier(item))}


def _carrier(item: ObjectSpec) -> str:
    if item.place is None:
        return ""
    return (item.place.on or item.place.inside or "").partition(".")[0]


def _is_undone(relation: str, moved: set[str], turned: set[str]) -> bool:
    """True if a relation may cease to hold when these objects, or their joints, are moved."""
    call = parse_call(relation)
    names = {argument.partition(".")[0] for argument in call.args}
    return bool(names & moved) or (call.predicate in ("Open", "Closed") and bool(names & turned))


def _placed_in_task(setup: TaskSetup, finding: Diagnostic) -> Diagnostic:
    """The finding at the place of the task that put the thing there, where one did."""
    parts = finding.path.split(".")
    if finding.code != "SF210" or len(parts) != 3:
        return finding
    for path, start in reversed(list(setup.starts())):
        if parts[1] in start.place:
            return setup.task.finding("SF210", (*path, "place", parts[1]), finding.message, finding.hint)
    return finding
