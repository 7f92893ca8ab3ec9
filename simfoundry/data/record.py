"""Record demonstrations: attempts from successive initial states until enough of them have succeeded.

With one task, attempt k starts from initial state k; several tasks take turns. The demonstrations are those of the
first n attempts that succeed and whose replay is identical, so they depend only on the tasks, the policy and the seed,
and neither on the number of processes nor on interruptions. Every finished attempt is written at once to
``unfinished/``. When the attempts before it are finished as well, they become shards; see
:mod:`simfoundry.data.store`.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path

from simfoundry.data.attempt import SILENCE_S, AttemptJob, carry_out, close, is_answered
from simfoundry.data.plan import RecordPlan, RecordSummary
from simfoundry.data.shards import Attempt
from simfoundry.data.store import AttemptStore
from simfoundry.errors import SimfoundryError
from simfoundry.evaluate.entries import ExpertChoice
from simfoundry.runtime.extras import need_extra
from simfoundry.runtime.files import locked_folder
from simfoundry.runtime.workers import GRACE_S, Limits, WorkerError, WorkerPool

# Number of consecutive attempts without a response after which recording stops, as in an evaluation.
GIVE_UP = 3

# Callback that receives each finished attempt, the number of demonstrations so far, and the number of attempts so far.
Seen = Callable[[Attempt, int, int], None]


def record(plan: RecordPlan, seen: Seen = lambda attempt, kept, of: None, workers: int = 1) -> RecordSummary:
    """Record demonstrations until there are enough, or until the attempts are used up. Existing ones are kept.

    Raises:
        SimfoundryError: If the policy does not respond, or if the folder cannot be used.
    """
    if isinstance(plan.contender.choice(), ExpertChoice):
        need_extra("expert", "policy `expert`")
    with _writing(plan.folder):
        store = AttemptStore(plan)
        carried_out = _in_workers(store, workers) if workers > 1 else _in_this_process(store)
        try:
            with closing(carried_out):
                _collect(store, carried_out, seen)
        except BaseException:
            with suppress(OSError):  # what was recorded so far can be read, also if the rest never follows
                store.finish()
            raise
        store.finish()
        return store.summary()


def _collect(store: AttemptStore, attempts: Iterator[Attempt], seen: Seen) -> None:
    """Store attempts as they finish."""
    silent = 0
    for attempt in attempts:
        silent = 0 if is_answered(attempt) else silent + 1
        if silent >= GIVE_UP:
            reason = attempt.about["reason"]
            raise SimfoundryError(f"policy `{store.plan.contender.label}` does not respond: {reason}")
        if is_answered(attempt):
            store.add(attempt)
            seen(attempt, store.kept, len(store.done))


@contextmanager
def _writing(folder: Path) -> Iterator[None]:
    """Lock a folder in which only this recording may write."""
    folder.mkdir(parents=True, exist_ok=True)
    with locked_folder(folder, "is being written by another recording; wait for it, or choose another folder"):
        yield


def _in_this_process(store: AttemptStore) -> Generator[Attempt]:
    try:
        while (job := store.next(set())) is not None:
            yield _raised(job, carry_out(job))
    finally:
        close()


def _in_workers(store: AttemptStore, workers: int) -> Generator[Attempt]:
    # Each worker has a second process that replays, and the two take turns.
    pool = WorkerPool(workers, Limits.shared(SILENCE_S, 2 * workers))
    running: dict[int, AttemptJob] = {}
    try:
        while True:
            while len(running) < workers and (job := store.next(set(running))) is not None:
                running[job.index] = job
                pool.submit(job.index, f"{carry_out.__module__}:carry_out", job, attempts=2)
            if not running:
                return
            index, outcome = pool.next()
            yield _raised(running.pop(index), outcome)
    finally:
        pool.close(GRACE_S)


def _raised(job: AttemptJob, outcome: Attempt | SimfoundryError) -> Attempt:
    """Return an attempt, or raise the error that prevented it."""
    if isinstance(outcome, WorkerError):
        raise SimfoundryError(f"the worker process for attempt {job.index} {outcome.how}")
    if isinstance(outcome, SimfoundryError):
        raise outcome
    return outcome
