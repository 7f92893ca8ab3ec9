"""Initial scenes of tasks: the `start` of a task, and then that of a step, applied to the scene's document."""

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
    """The documents of a ``task`` and its ``scene``, and the ``step`` at which it starts, empty for the first."""

    task: Loaded
    scene: Loaded
    step: str = ""
    cache: Cache | None = None

    @property
    def task_spec(self) -> TaskSpec:
        """The task's document."""
        assert isinstance(self.task.spec, TaskSpec)
        return self.task.spec

    @property
    def scene_spec(self) -> SceneSpec:
        """The scene's document."""
        assert isinstance(self.scene.spec, SceneSpec)
        return self.scene.spec

    def with_step(self, name: str) -> TaskSetup:
        """Return the same documents, starting at a step."""
        return replace(self, step=name)

    @property
    def put_by_step(self) -> frozenset[str]:
        """Names of the objects that the step's own start places."""
        start = self.task_spec.subtasks[self.step].start if self.step else None
        return frozenset((*start.place, *start.pose)) if start is not None else frozenset()

    def starts(self) -> Iterator[tuple[tuple[str, ...], Start]]:
        """Yield the changes to the scene in order of application, each with its path in the task."""
        yield ("start",), self.task_spec.start
        own = self.task_spec.subtasks[self.step].start if self.step else None
        if own is not None:
            yield ("subtasks", self.step, "start"), own


def lowered(setup: TaskSetup) -> Scene:
    """Lower the scene as the task starts; raises :class:`SpecError`, with places in the task if its start is at
    fault.
    """
    spec = started(setup)
    try:
        return lower(replace(setup.scene, spec=spec), setup.cache)
    except SpecError as error:
        raise SpecError([_placed_in_task(setup, d) for d in error.diagnostics]) from None


def started(setup: TaskSetup) -> SceneSpec:
    """Apply the starts to the scene's document; relations that they break are removed."""
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
    """Supporting object of each object, if stated by the documents."""
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
    """Return whether moving these objects, or their joints, may break a relation."""
    call = parse_call(relation)
    names = {argument.partition(".")[0] for argument in call.args}
    return bool(names & moved) or (call.predicate in ("Open", "Closed") and bool(names & turned))


def _placed_in_task(setup: TaskSetup, finding: Diagnostic) -> Diagnostic:
    """Relocate a finding to the place in the task that placed the object, if there is one."""
    parts = finding.path.split(".")
    if finding.code != "SF210" or len(parts) != 3:
        return finding
    for path, start in reversed(list(setup.starts())):
        if parts[1] in start.place:
            return setup.task.finding("SF210", (*path, "place", parts[1]), finding.message, finding.hint)
    return finding
