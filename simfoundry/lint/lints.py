"""Lints by name, and their input: a document of the right kind, lowered as a draft."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from simfoundry.runtime.plugins import Registry
from simfoundry.spec.diagnostics import Diagnostic
from simfoundry.spec.files import Loaded
from simfoundry.spec.models.predicate import Call

if TYPE_CHECKING:
    from simfoundry.lint.draft import DraftScene
    from simfoundry.lint.report import Path_
    from simfoundry.spec.models.task import TaskSpec


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
        from simfoundry.lint.goals import pending

        return pending(self)


LINTS = Registry(
    "simfoundry.lints",
    {
        "lost_texture": "simfoundry.lint.lost_texture:LINT",
        "overlap": "simfoundry.lint.overlap:LINT",
        "unsupported": "simfoundry.lint.unsupported:LINT",
        "out_of_view": "simfoundry.lint.out_of_view:SCENE_LINT",
        "broken_relation": "simfoundry.lint.broken_relation:LINT",
        "true_at_start": "simfoundry.lint.true_at_start:LINT",
        "too_wide": "simfoundry.lint.too_wide:LINT",
        "out_of_reach": "simfoundry.lint.out_of_reach:LINT",
        "start_out_of_view": "simfoundry.lint.out_of_view:TASK_LINT",
    },
    Lint,
)
"""Lints by name, in the order in which they run."""
