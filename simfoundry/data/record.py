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

from simfoundry.data.attempt import LIMITS, AttemptJob, carry_out, is_answered
from simfoundry.data.plan import RecordPlan, RecordSummary
from simfoundry.data.shards import Attempt
from simfoundry.data.store import AttemptStore
from simfoundry.errors import SimfoundryError
from simfoundry.evaluate.entries import ExpertChoice
from simfoundry.runtime.executors import LOCAL, Executor, Machines, carry_out_jobs, open_executor
from simfoundry.runtime.extras import need_extra
from simfoundry.runtime.files import locked_folder
from simfoundry.runtime.workers import WorkerError

# Number of consecutive attempts without a response after which recording stops, as in an evaluation.
GIVE_UP = 3

# Callback that receives each finished attempt, the number of demonstrations so far, and the number of attempts so far.
Seen = Callable[[Attempt, int, int], None]


def record(
    plan: RecordPlan,
    seen: Seen = lambda attempt, kept, of: None,
    workers: int | None = 1,
    machines: Machines = LOCAL,
) -> RecordSummary:
    """Record demonstrations until there are enough, or until the attempts are used up. Existing ones are kept.

    Raises:
        SimfoundryError: If the policy does not respond, or if the folder cannot be used.
    """
    if isinstance(plan.contender.choice(), ExpertChoice):
        need_extra("expert", "policy `expert`")
    with recording_folder(plan.folder):
        store = AttemptStore(plan)
        if store.next(set()) is not None:
            executor = open_executor(machines, workers, LIMITS, plan.contender.is_foreign)
            try:
                with closing(_attempts(store, executor)) as attempts:
                    _collect(store, attempts, seen)
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
def recording_folder(folder: Path) -> Iterator[None]:
    """Lock a folder in which only this recording may write."""
    folder.mkdir(parents=True, exist_ok=True)
    with locked_folder(folder, "is being written by another recording; wait for it, or choose another folder"):
        yield


def _attempts(store: AttemptStore, executor: Executor) -> Generator[Attempt]:
    """Yield attempts as they finish."""
    running: set[int] = set()

    def next_job() -> AttemptJob | None:
        job = store.next(running)
        if job is not None:
            running.add(job.index)
        return job

    with closing(carry_out_jobs(executor, f"{carry_out.__module__}:carry_out", next_job)) as finished:
        for job, outcome in finished:
            running.discard(job.index)
            yield _raised(job, outcome)


def _raised(job: AttemptJob, outcome: Attempt | SimfoundryError) -> Attempt:
    """Return an attempt, or raise the error that prevented it."""
    if isinstance(outcome, WorkerError):
        raise SimfoundryError(f"the worker process for attempt {job.index} {outcome.how}")
    if isinstance(outcome, SimfoundryError):
        raise outcome
    return outcome
