"""Run stages, or reuse their earlier results if what they depend on has not changed."""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Mapping
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any, Generic, Literal, Self, TypeVar

from simfoundry.assets.cache import key_of
from simfoundry.capture.frame import CaptureError
from simfoundry.capture.stages.stage import STAGES, stage_index
from simfoundry.capture.stages.store import StageStore, encoded
from simfoundry.runtime.process_pair import ProcessPair

T = TypeVar("T")

StageState = Literal["ran", "cached", "stale"]


class StaleStageError(CaptureError):
    """Raised for a result that is out of date, by a runner that only examines."""

    def __init__(self, stage: str, label: str) -> None:
        super().__init__("SF505", f"the stage `{stage}` is out of date {label}".strip(), "")


@dataclass(frozen=True, eq=False)
class StageResult(Generic[T]):
    """A result of a stage, and the digest of its content, which the keys of later stages contain."""

    value: T
    digest: str


@dataclass
class StageRunner:
    """Runs stages and reuses their earlier results.

    Attributes:
        store: Where results are kept, or None to keep nothing.
        redo_from: Name of the first stage that is run again although nothing has changed, or None.
        only: Objects, by their labels, for which stages are run again. Empty: all.
        examine: True to run and write nothing: :class:`StaleStageError` is raised instead.
        states: What happened in each stage, by stage and label.
        overridden: Stages and labels whose results contain statements of a person.
        processes: The processes that share long work, or None for this one.
    """

    store: StageStore | None = None
    redo_from: str | None = None
    only: Collection[str] = ()
    examine: bool = False
    states: dict[tuple[str, str], StageState] = field(default_factory=dict)
    overridden: set[tuple[str, str]] = field(default_factory=set)
    processes: ProcessPair | None = None
    _begun: list[Future[Any]] = field(default_factory=list)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Wait for everything that was begun, so that nothing is written later."""
        wait(self._begun)

    @property
    def size(self) -> int:
        """The number of processes that run long work at the same time."""
        return 1 if self.processes is None else self.processes.size

    def run(
        self,
        name: str,
        inputs: Mapping[str, str],
        compute: Callable[[], T],
        label: str = "",
        quick: bool = False,
        provisional: Callable[[T], bool] | None = None,
        shared: bool = False,
        beside: bool = False,
    ) -> StageResult[T]:
        """Return the result of the stage ``name``, reusing an earlier one with equal inputs.

        Args:
            name: Name of the stage.
            inputs: Digests, or short texts, of everything that the result depends on.
            compute: Computes the result.
            label: The object, for a stage that runs once for each object.
            quick: True if the result takes so little time that a runner that only examines computes it too.
            provisional: Tells whether a result is to be computed again by the next run. The default keeps all results.
            shared: True if ``compute`` is long, and a partial of a module-level function, which any process can run.
            beside: True if the result is not needed soon; the second process then computes it when it has nothing else
                to do.

        Raises:
            StaleStageError: The runner only examines, and there is no earlier result with equal inputs.
        """
        stage = STAGES[stage_index(name)]
        key = key_of(stage.name, stage.version, json.dumps(dict(inputs), sort_keys=True))
        found = None if self.store is None or self._is_redone(name, label) else self.store.find(key)
        if found is not None:
            self.states[name, label] = "cached"
            return StageResult(*found)
        if self.examine:
            self.states[name, label] = "stale"
            if not quick:
                raise StaleStageError(name, label)
            value = compute()
            return StageResult(value, encoded(value)[2])
        value = self.processes.run(compute, beside) if shared and self.processes is not None else compute()
        self.states[name, label] = "ran"
        if provisional is not None and provisional(value):
            return StageResult(value, encoded(value)[2])
        digest = key if self.store is None else self.store.write(stage, label, key, inputs, value)
        return StageResult(value, digest)

    def begin(self, function: Callable[[], T]) -> Callable[[], T]:
        """Start a function in a thread, and return a function that waits for its result.

        Threads take turns, except in NumPy, OpenCV and MuJoCo, while they use files, and in the second process.
        """
        pool = ThreadPoolExecutor(1)
        future = pool.submit(function)
        pool.shutdown(wait=False)
        self._begun.append(future)
        return future.result

    def ordered_states(self) -> dict[tuple[str, str], StageState]:
        """Return the states in the order of the stages, and of the labels in each."""
        return dict(sorted(self.states.items(), key=lambda item: (stage_index(item[0][0]), item[0][1])))

    def _is_redone(self, name: str, label: str) -> bool:
        if self.redo_from is None or stage_index(name) < stage_index(self.redo_from):
            return False
        return not self.only or label in self.only
