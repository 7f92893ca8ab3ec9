"""The registry of lints, and a function that runs them on a document and its draft scene."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

from simfoundry.runtime.plugins import PluginError, Registry, plugins
from simfoundry.spec.check.documents import sift, unused
from simfoundry.spec.compose.findings import collapsed, with_sources
from simfoundry.spec.diagnostics import Diagnostic, Severity, SpecError
from simfoundry.spec.files import Loaded
from simfoundry.spec.models.predicate import Call

if TYPE_CHECKING:
    from simfoundry.lint.draft import DraftScene
    from simfoundry.scene.model import Link
    from simfoundry.scene.task_start import Starts
    from simfoundry.spec.models.task import TaskSpec

Path_ = tuple[str | int, ...]

# Maximum number of findings per lint shown for one document; further findings appear once these are fixed.
MOST = 200


def warning(loaded: Loaded, code: str, path: Path_, message: str, hint: str, about: tuple[str, ...] = ()) -> Diagnostic:
    """Return a warning about a value in a document.

    Args:
        loaded: The document.
        code: Code of the finding.
        path: Path of the value.
        message: Description of the problem.
        hint: Suggestion for how to fix the problem.
        about: Names under which ``allow`` can suppress the warning, in addition to those in the path.
    """
    assert loaded.document is not None
    return replace(loaded.document.finding(code, path, message, hint, Severity.WARNING), about=about)


def where(loaded: Loaded, name: str) -> Path_:
    """Return the path of an object's placement or pose, or the path of the object itself if it has neither."""
    assert loaded.document is not None
    path: Path_ = ("objects", name)
    for key in ("place", "pose"):
        if len(loaded.document.known((*path, key))) == 3:
            return (*path, key)
    return path


@dataclass(frozen=True)
class Lint:
    """A check that yields findings with a single code for some kinds of documents.

    Kinds are specified as in ``scene/1``, ``asset/1`` or ``task/1``.
    """

    code: str
    kinds: tuple[str, ...]
    find: Callable[[Subject], Iterator[Diagnostic]]


@dataclass(frozen=True, eq=False)
class Subject:
    """A document without errors, and its draft scene.

    For a task, ``draft`` is the scene in which the task starts, and ``steps`` contains the scenes of the steps that
    have their own start. For an asset, ``draft`` is None, and ``links`` contains its links. Lints call ``checkpoint``
    before each slow measurement; it raises an exception if the findings are no longer needed.
    """

    loaded: Loaded
    draft: DraftScene | None = None
    steps: Mapping[str, DraftScene] = field(default_factory=dict)
    links: tuple[Link, ...] = ()
    checkpoint: Callable[[], None] = lambda: None

    @property
    def is_task(self) -> bool:
        """True if the document is a task."""
        return getattr(self.loaded.spec, "simfoundry", "") == "task/1"

    @property
    def scene(self) -> DraftScene:
        """The draft scene."""
        assert self.draft is not None
        return self.draft

    @property
    def task(self) -> TaskSpec:
        """The task that the document defines."""
        from simfoundry.spec.models.task import TaskSpec

        assert isinstance(self.loaded.spec, TaskSpec)
        return self.loaded.spec

    @cached_property
    def pending(self) -> list[tuple[Call, Path_]]:
        """Predicates that the task's goals require but that do not hold initially, each with the path of its goal."""
        from simfoundry.lint.conditions import pending

        return pending(self)


# Lints by name, in the order in which they run.
LINTS = Registry(
    "simfoundry.lints",
    {
        "background": "simfoundry.lint.views:BACKGROUND",
        "robot_model": "simfoundry.lint.robot_models:ROBOT_MODEL",
        "robot_joints": "simfoundry.lint.robot_models:ROBOT_JOINTS",
        "acting_robot": "simfoundry.lint.robot_models:ACTING_ROBOT",
        "no_cavity": "simfoundry.lint.conditions:NO_CAVITY",
        "center_of_mass": "simfoundry.lint.bodies:CENTER_OF_MASS",
        "lost_texture": "simfoundry.lint.views:LOST_TEXTURE",
        "overlap": "simfoundry.lint.contacts:OVERLAP",
        "unsupported": "simfoundry.lint.contacts:UNSUPPORTED",
        "region_off_support": "simfoundry.lint.contacts:REGION_OFF_SUPPORT",
        "out_of_view": "simfoundry.lint.views:OUT_OF_VIEW",
        "broken_relation": "simfoundry.lint.conditions:BROKEN_RELATION",
        "true_at_start": "simfoundry.lint.conditions:TRUE_AT_START",
        "too_wide": "simfoundry.lint.robots:TOO_WIDE",
        "out_of_reach": "simfoundry.lint.robots:OUT_OF_REACH",
        "start_out_of_view": "simfoundry.lint.views:START_OUT_OF_VIEW",
    },
    Lint,
)


def lint(
    loaded: Loaded, seen: set[Path] | None = None, checkpoint: Callable[[], None] = lambda: None
) -> tuple[Diagnostic, ...]:
    """Run the lints once on a document and on each document that it uses.

    Findings that are suppressed by a document's ``allow`` are omitted. An ``allow`` entry that does not suppress
    anything is itself a finding.

    Args:
        loaded: The document. If it has errors, it is not linted.
        seen: Paths of documents to skip. Documents that are linted are added to this set.
        checkpoint: Function that is called before each step. It can raise an exception to stop.

    Returns:
        The findings.
    """
    seen = set() if seen is None else seen
    if loaded.spec is None or loaded.document is None or loaded.errors:
        return ()
    path = Path(loaded.document.file).absolute()
    if path in seen:
        return ()
    seen.add(path)
    findings = [d for used in loaded.uses.values() for d in lint(used, seen, checkpoint)]
    subject, errors = subject_of(loaded, checkpoint)
    return tuple(findings) + lint_subject(loaded, subject, errors)


def lint_subject(loaded: Loaded, subject: Subject | None, errors: Sequence[Diagnostic]) -> tuple[Diagnostic, ...]:
    """Run the lints on one document, without the documents that it uses.

    Args:
        loaded: The document, which has no errors.
        subject: Its drafts.
        errors: The errors from lowering it. See :func:`subject_of`.
    """
    assert loaded.spec is not None and loaded.document is not None
    kept, silenced = sift(with_sources(_lints(loaded, subject, errors), loaded.reuse), loaded.spec.allow)
    findings = collapsed(kept, loaded.reuse)
    # Ignore unused entries inherited from a base document; they may suppress findings in that document.
    idle = unused(loaded.document, loaded.spec.allow, [*loaded.silenced, *silenced])
    findings += [d for d in idle if d.file == loaded.document.file]
    return tuple(findings)


def _lints(loaded: Loaded, subject: Subject | None, errors: Sequence[Diagnostic]) -> Iterator[Diagnostic]:
    """Yield the findings for one document: the errors from lowering or, if there are no errors, the lint findings."""
    kind = getattr(loaded.spec, "simfoundry", "")
    yield from errors
    if subject is None:
        return
    lints, unusable = LINTS.load_all()
    for name, cause in unusable.items():  # reported at the plug-in, because no document is at fault
        yield Diagnostic(name, Severity.WARNING, str(cause), plugins(LINTS.group)[name].value)
    for name, one in lints.items():
        subject.checkpoint()
        try:
            if kind in one.kinds:
                with LINTS.running(name):
                    yield from islice(one.find(subject), MOST)
        except PluginError as error:
            yield warning(loaded, one.code, (), str(error), "")


def subject_of(
    loaded: Loaded,
    checkpoint: Callable[[], None] = lambda: None,
    earlier: DraftScene | None = None,
    shown: bool = False,
) -> tuple[Subject | None, list[Diagnostic]]:
    """Return the drafts of a document, or None if it has none or cannot be lowered; and the errors from lowering.

    Args:
        loaded: The document, which has no errors.
        checkpoint: Function that is called before each step, here and in the lints. It can raise an exception to stop.
        earlier: An earlier draft of the same document, whose objects are reused if they have not changed.
        shown: Whether the draft of the scene, or of the initial state of a task, gets the visuals of a build.
    """
    kind = getattr(loaded.spec, "simfoundry", "")
    if kind not in ("scene/1", "asset/1", "task/1"):
        return None, []
    from simfoundry.lint import draft

    if kind == "asset/1":
        links, errors = draft.drafted_links(loaded)
        return Subject(loaded, links=links, checkpoint=checkpoint), errors
    steps, errors = draft.drafted_steps(loaded, checkpoint) if kind == "task/1" else ({}, [])
    try:
        return Subject(
            loaded, draft.drafted_start(loaded, checkpoint, earlier, shown), steps, checkpoint=checkpoint
        ), errors
    except SpecError as error:
        starts: Starts | None = {("start",): getattr(loaded.spec, "start")} if kind == "task/1" else None  # noqa: B009
        return None, list(dict.fromkeys([*draft.own_findings(loaded, error, starts), *errors]))
