"""Lints by name, their input (a document lowered as a draft), and their findings in a document."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from simfoundry.runtime.plugins import Registry
from simfoundry.spec.check.documents import sift, unused
from simfoundry.spec.diagnostics import Diagnostic, Severity, SpecError
from simfoundry.spec.files import Loaded
from simfoundry.spec.models.predicate import Call

if TYPE_CHECKING:
    from simfoundry.lint.draft import DraftScene
    from simfoundry.spec.models.task import TaskSpec

Path_ = tuple[str | int, ...]

MOST = 200
"""Number of findings of one kind shown for one document; more appear once these are fixed."""


def warning(loaded: Loaded, code: str, path: Path_, message: str, hint: str, about: tuple[str, ...] = ()) -> Diagnostic:
    """Return a warning at a place of a document; ``about`` lists names that ``allow`` accepts besides those in the
    path.
    """
    assert loaded.document is not None
    return replace(loaded.document.finding(code, path, message, hint, Severity.WARNING), about=about)


def where(loaded: Loaded, name: str) -> Path_:
    """Return the path of an object's pose or placement, or of the object itself if it has neither."""
    assert loaded.document is not None
    path: Path_ = ("objects", name)
    for key in ("place", "pose"):
        if len(loaded.document.known((*path, key))) == 3:
            return (*path, key)
    return path


@dataclass(frozen=True)
class Lint:
    """A check of one kind of document (``scene/1``, ``asset/1``, ``task/1``): yields findings of one code."""

    code: str
    kinds: tuple[str, ...]
    find: Callable[[Subject], Iterator[Diagnostic]]


@dataclass(frozen=True, eq=False)
class Subject:
    """A document without errors, and its scene or the scene that it starts in; None for an asset."""

    loaded: Loaded
    draft: DraftScene | None = None

    @property
    def scene(self) -> DraftScene:
        """Draft scene."""
        assert self.draft is not None
        return self.draft

    @property
    def task(self) -> TaskSpec:
        """Task of the document."""
        from simfoundry.spec.models.task import TaskSpec

        assert isinstance(self.loaded.spec, TaskSpec)
        return self.loaded.spec

    @cached_property
    def pending(self) -> list[tuple[Call, Path_]]:
        """Predicates that the goals of a task require and that do not hold yet, each with its path."""
        from simfoundry.lint.conditions import pending

        return pending(self)


LINTS = Registry(
    "simfoundry.lints",
    {
        "lost_texture": "simfoundry.lint.views:LOST_TEXTURE",
        "overlap": "simfoundry.lint.contacts:OVERLAP",
        "unsupported": "simfoundry.lint.contacts:UNSUPPORTED",
        "out_of_view": "simfoundry.lint.views:OUT_OF_VIEW",
        "broken_relation": "simfoundry.lint.conditions:BROKEN_RELATION",
        "true_at_start": "simfoundry.lint.conditions:TRUE_AT_START",
        "too_wide": "simfoundry.lint.robots:TOO_WIDE",
        "out_of_reach": "simfoundry.lint.robots:OUT_OF_REACH",
        "start_out_of_view": "simfoundry.lint.views:START_OUT_OF_VIEW",
    },
    Lint,
)
"""Lints by name, in the order in which they run."""


def lint(loaded: Loaded, seen: set[Path] | None = None) -> tuple[Diagnostic, ...]:
    """Return the findings of a document without errors and of the documents that it uses, each document once.

    Findings suppressed by its ``allow`` are left out; an entry that suppresses nothing is a finding. Documents in
    ``seen`` are skipped; those that are checked are added to it.
    """
    seen = set() if seen is None else seen
    if loaded.spec is None or loaded.document is None or loaded.errors:
        return ()
    path = Path(loaded.document.file).absolute()
    if path in seen:
        return ()
    seen.add(path)
    findings = [d for used in loaded.uses.values() for d in lint(used, seen)]
    kept, silenced = sift(_lints(loaded), loaded.spec.allow)
    findings += kept
    # An entry inherited from a base document may suppress a finding only there.
    idle = unused(loaded.document, loaded.spec.allow, [*loaded.silenced, *silenced])
    findings += [d for d in idle if d.file == loaded.document.file]
    return tuple(findings)


def _lints(loaded: Loaded) -> Iterator[Diagnostic]:
    """Return the findings of one document: the errors of lowering, or if there are none, those of the lints."""
    kind = getattr(loaded.spec, "simfoundry", "")
    if kind not in ("scene/1", "asset/1", "task/1"):
        return
    from simfoundry.lint.draft import asset_faults, drafted_start

    try:
        subject = Subject(loaded, None if kind == "asset/1" else drafted_start(loaded))
    except SpecError as error:  # for a task or a used document, the scene's own check reports this
        yield from (d for d in error.diagnostics if loaded.document is not None and d.file == loaded.document.file)
        return
    if kind == "asset/1":
        yield from asset_faults(loaded)
    for one in LINTS.load_all().values():
        if kind in one.kinds:
            yield from one.find(subject)
