"""Read the texts of a session: the documents, their findings, and the scene that is shown."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from simfoundry.errors import SimfoundryError
from simfoundry.geometry.frames import Pose
from simfoundry.lint.draft import DraftScene
from simfoundry.lint.lints import Subject, lint, lint_subject, subject_of
from simfoundry.predicates import Judge, PredicateError, Verdict
from simfoundry.scene.frames import FrameTree
from simfoundry.scene.lower import Lowering, lower_robots, lower_surroundings
from simfoundry.scene.model import Scene, SceneObject
from simfoundry.scene.state import SceneState
from simfoundry.spec.diagnostics import Diagnostic, Severity, SpecError
from simfoundry.spec.files import Loaded
from simfoundry.spec.models.kinds import KINDS
from simfoundry.spec.models.predicate import ExpressionError, texts
from simfoundry.spec.models.scene import SceneSpec
from simfoundry.spec.models.task import TaskSpec
from simfoundry.spec.open_documents import OpenDocuments


@dataclass(frozen=True, eq=False)
class StudioScene:
    """A valid state of the documents that a session edits.

    Attributes:
        root: The document that was opened: a scene or a task.
        loaded: The scene document.
        draft: The scene as the task starts it, with the visuals and colliders that simulators get.
        surroundings: A scene that contains only the robots, lights and the background.
        texts: Texts of all open documents, by resolved path.
    """

    root: Loaded
    loaded: Loaded
    draft: DraftScene
    surroundings: Scene
    texts: Mapping[Path, str] = field(default_factory=dict)

    @property
    def spec(self) -> SceneSpec:
        """The scene document, with everything that it inherits, repeats and includes written out."""
        assert isinstance(self.loaded.spec, SceneSpec)
        return self.loaded.spec

    @property
    def task(self) -> TaskSpec | None:
        """The task document, or None if a scene was opened."""
        return self.root.spec if isinstance(self.root.spec, TaskSpec) else None

    @property
    def scene(self) -> Scene:
        """The lowered objects and cameras."""
        return self.draft.scene

    @property
    def objects(self) -> dict[str, SceneObject]:
        """The lowered objects by name."""
        return self.draft.scene.by_name

    @cached_property
    def frames(self) -> FrameTree:
        """The frames to which poses can refer."""
        return FrameTree(self.draft.spec)

    @cached_property
    def judge(self) -> Judge:
        """The judge of conditions in the scene."""
        return Judge(self.draft.scene)

    @cached_property
    def start(self) -> SceneState:
        """The initial state of the scene."""
        return SceneState.initial(self.draft.scene)

    def X_WF(self, reference: str | None) -> Pose:
        """Return the pose of a frame in the world; None is the world frame."""
        return self.frames.pose(reference, self.objects)

    @cached_property
    def conditions(self) -> tuple[tuple[str, str], ...]:
        """The predicates of the relations, the goal, and the steps, each with what states it."""
        found = [("relation", text) for text in self.spec.relations]
        if self.task is not None:
            found += [("goal", text) for text, _ in texts(self.task.goal)]
            found += [(f"step {name}", text) for name, s in self.task.subtasks.items() for text, _ in texts(s.goal)]
        return tuple(dict.fromkeys(found))


@dataclass(frozen=True, eq=False)
class Reading:
    """Meaning of the texts of a session.

    Attributes:
        loaded: The document that was opened.
        findings: The findings of structure, and the errors of lowering.
        scene: The scene, or None if there are errors.
        subject: What lints judge, or None if there are errors.
    """

    loaded: Loaded
    findings: tuple[Diagnostic, ...]
    scene: StudioScene | None = None
    subject: Subject | None = None

    @property
    def errors(self) -> tuple[Diagnostic, ...]:
        """The findings that are errors."""
        return tuple(d for d in self.findings if d.severity is Severity.ERROR)

    @property
    def first_error(self) -> str:
        """The first error as a sentence with its place."""
        errors = self.errors
        if not errors:
            return "the document does not describe a scene"
        first = errors[0]
        more = f" (and {len(errors) - 1} more)" if len(errors) > 1 else ""
        hint = f"; {first.hint}" if first.hint else ""
        return f"{Path(first.document).name}:{first.line}:{first.column}: {first.message}{hint}{more}"


def ensure_scene_or_task(loaded: Loaded) -> None:
    """Ensure that a document is a scene or a task, or was one before it became invalid.

    Raises:
        SimfoundryError: If it is something else.
    """
    data = loaded.source.data if loaded.source is not None else None
    kind = str(data.get("simfoundry", "")) if isinstance(data, dict) else ""
    is_named = loaded.path.name.endswith((".scene.yaml", ".task.yaml"))
    if kind not in ("scene/1", "task/1") and (kind in KINDS or not is_named):
        what = f"of the kind `{kind}`" if kind in KINDS else "not a document"
        raise SimfoundryError(f"{loaded.path} is {what}; the studio opens scenes and tasks")


def read_session(
    path: Path, documents: OpenDocuments, texts: Mapping[Path, str], earlier: StudioScene | None = None
) -> Reading:
    """Read the document that a session has opened.

    Args:
        path: The document, a scene or a task.
        documents: The open documents, with the same texts.
        texts: The texts by resolved path.
        earlier: The scene of an earlier reading, whose unchanged parts are reused.

    Raises:
        SimfoundryError: If the document has never been a scene or a task.
    """
    loaded = documents.load(path)
    if earlier is None:
        ensure_scene_or_task(loaded)
    findings = tuple(loaded.all_findings())
    if loaded.errors or not isinstance(loaded.spec, SceneSpec | TaskSpec):
        return Reading(loaded, findings)
    try:
        subject, errors = _subject(loaded, earlier)
    except SpecError as error:
        return Reading(loaded, (*findings, *error.diagnostics))
    if subject is None or subject.draft is None:
        return Reading(loaded, (*findings, *errors))
    scene_loaded = loaded
    if isinstance(loaded.spec, TaskSpec):
        used = loaded.used(loaded.spec.scene)
        assert used is not None
        scene_loaded = used
    try:
        surroundings = _surroundings(scene_loaded, subject.draft, earlier)
    except SpecError as error:
        return Reading(loaded, (*findings, *errors, *error.diagnostics))
    scene = StudioScene(loaded, scene_loaded, subject.draft, surroundings, dict(texts))
    return Reading(loaded, (*findings, *errors), scene, subject)


def _subject(loaded: Loaded, earlier: StudioScene | None) -> tuple[Subject | None, list[Diagnostic]]:
    draft = earlier.draft if earlier is not None and earlier.loaded.path == _scene_path(loaded) else None
    return subject_of(loaded, earlier=draft, shown=True)


def _scene_path(loaded: Loaded) -> Path:
    return loaded.file(loaded.spec.scene) if isinstance(loaded.spec, TaskSpec) else loaded.path


def _surroundings(loaded: Loaded, draft: DraftScene, earlier: StudioScene | None) -> Scene:
    """Return the robots, lights and background, which are those of the earlier scene if nothing about them differs."""
    spec = draft.spec
    if earlier is not None:
        old = earlier.draft.spec
        names = ("robots", "lights", "background", "frames", "materials")
        still = not spec.frames and all(getattr(spec, name) == getattr(old, name) for name in names)
        if still and earlier.surroundings.background is None:
            return earlier.surroundings
    lowering = Lowering(loaded, fetch=False, draft=True, shown=True)
    scene = draft.scene
    for each in (lower_robots, lower_surroundings):
        scene = each(lowering, scene)
    return Scene(
        scene.name, scene.gravity, (), lights=scene.lights, robots=scene.robots, background=scene.background,
        left_out=scene.left_out,
    )  # fmt: skip


def changed_objects(before: StudioScene, after: StudioScene, names: Collection[str]) -> list[str]:
    """Return those of the named objects of a scene that another one moves, changes or lacks, in alphabetical order."""

    def is_same(name: str) -> bool:
        if name not in after.objects or name not in after.spec.objects:
            return False
        X_WO, X_WO_after = before.objects[name].X_WO, after.objects[name].X_WO
        is_still = X_WO.p.tolist() == X_WO_after.p.tolist() and X_WO.q.tolist() == X_WO_after.q.tolist()
        return is_still and before.spec.objects[name] == after.spec.objects[name]

    return sorted(name for name in names if name in before.objects and not is_same(name))


def lint_findings(reading: Reading, checkpoint: Callable[[], None] = lambda: None) -> tuple[Diagnostic, ...]:
    """Return all findings of a reading, including those of the lints, which take longer."""
    if reading.subject is None or reading.loaded.errors:
        return reading.findings
    checkpoint()
    used = (d for each in reading.loaded.uses.values() for d in lint(each, checkpoint=checkpoint))
    return tuple(dict.fromkeys([*reading.findings, *lint_subject(reading.loaded, reading.subject, ()), *used]))


def verdict(scene: StudioScene, condition: Any, state: SceneState | None = None) -> Verdict | None:
    """Return the verdict on a condition in a state, by default the initial one, or None if it cannot be evaluated."""
    try:
        return scene.judge(condition, scene.start if state is None else state)
    except (PredicateError, ExpressionError):
        return None
