"""A session of teleoperation: attempts of a person, of which the successful ones become demonstrations."""

from __future__ import annotations

import hashlib
import math
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

from simfoundry.data.attempt import NOT_REPRODUCED, AttemptJob, OpenTask, attempt_facts, verified_attempt
from simfoundry.data.plan import RecordPlan
from simfoundry.data.shards import Attempt
from simfoundry.data.store import AttemptStore
from simfoundry.errors import SimfoundryError
from simfoundry.evaluate.entries import Choice, Contender
from simfoundry.evaluate.policies.base import PolicyError
from simfoundry.evaluate.resets.starts import RolloutStart
from simfoundry.evaluate.rollouts.rollout import Rollout, rollout
from simfoundry.evaluate.task import Task
from simfoundry.scene.state import SceneState
from simfoundry.teleop.commands import Control
from simfoundry.teleop.sources import EventSource
from simfoundry.teleop.teleoperator import AttemptEndedError, Teleoperator

DISCARDED = "discarded"
"""The end of an attempt that the person has given up, or whose success was not saved."""


@dataclass(frozen=True)
class TeleopContender(Contender):
    """A person at any device. Demonstrations of one folder can come from several devices."""

    label: str = "teleop"
    text: str = "teleop"

    def choice(self) -> Choice:
        """People are not policies that a text selects."""
        raise PolicyError("a person acts only in `simfoundry teleop`")

    @property
    def is_foreign(self) -> bool:
        """The rollouts of a session run in its own process."""
        return False

    @property
    def digest(self) -> str:
        """A digest of the way in which people act, which is the same for all of them."""
        return hashlib.sha256(b"teleop/1").hexdigest()[:16]


class SessionView(Protocol):
    """The receiver of a session's progress, such as a page."""

    def begin(self, task: Task, attempt: int, kept: int) -> None:
        """Show that an attempt is being prepared."""

    def show(self, state: SceneState) -> None:
        """Show a state that the world has reached."""

    def tell(self, text: str, is_over: bool = False) -> None:
        """Show a message. ``is_over`` is set if the attempt waits for a decision."""


class SilentView(SessionView):
    """A view that shows nothing."""

    def begin(self, task: Task, attempt: int, kept: int) -> None:
        """Show nothing."""

    def show(self, state: SceneState) -> None:
        """Show nothing."""

    def tell(self, text: str, is_over: bool = False) -> None:
        """Show nothing."""


@dataclass(frozen=True)
class TeleopSummary:
    """The results of a session.

    Attributes:
        kept: The number of demonstrations in the folder.
        attempts: The number of finished attempts in the folder.
        saved: The number of demonstrations that the session added.
        retries: The number of attempts that were repeated from the same initial state.
        failures: The number of the session's other attempts, by the reason why they ended.
        digests: The digest of the trajectory of each finished rollout of the session.
        was_ended: Whether the person, or the end of the stream, ended the session.
    """

    kept: int
    attempts: int
    saved: int
    retries: int
    failures: Mapping[str, int]
    digests: tuple[str, ...]
    was_ended: bool


@dataclass
class _Counts:
    saved: int = 0
    retries: int = 0
    failures: Counter[str] = field(default_factory=Counter)
    digests: list[str] = field(default_factory=list)


class TeleopSession:
    """A session, which adds attempts to a folder of demonstrations until there are enough, or until it is ended."""

    def __init__(
        self, plan: RecordPlan, opened: OpenTask, teleoperator: Teleoperator, source: EventSource, view: SessionView
    ) -> None:
        """Prepare a session of a plan with one task, which ``opened`` holds open."""
        self._plan, self._opened, self._view = plan, opened, view
        self._teleoperator, self._source = teleoperator, source
        self._counts = _Counts()

    def run(self, store: AttemptStore, until: Callable[[], bool] = lambda: False) -> TeleopSummary:
        """Carry out attempts.

        Args:
            store: The folder of demonstrations.
            until: Function that returns True if no more attempts should begin.

        Raises:
            SimfoundryError: If no initial state is found, or if the device cannot be used.
        """
        was_ended = False
        try:
            while not until() and (job := store.next(set())) is not None:
                attempt = self._attempt(job, store)
                if attempt is None:
                    was_ended = True
                    break
                store.add(attempt)
        except KeyboardInterrupt:
            was_ended = True
        finally:
            store.finish()
        whole, mine = store.summary(), self._counts
        counts = mine.saved, mine.retries, dict(mine.failures), tuple(mine.digests)
        return TeleopSummary(whole.kept, whole.attempts, *counts, was_ended)

    def _attempt(self, job: AttemptJob, store: AttemptStore) -> Attempt | None:
        """Repeat an attempt until it is decided, and return it, or None if the session ends."""
        view = self._view
        view.tell("Searching for the initial state …")
        start = self._opened.start(job.seed, job.start)
        while True:
            view.begin(self._opened.task, job.index, store.kept)
            self._teleoperator.begin(job.start)
            control, done = self._rollout(start)
            if control is Control.QUIT:
                return None
            if control is Control.RETRY:
                self._counts.retries += 1
                continue
            attempt = (
                self._saved(job, start, done) if control is Control.SAVE and done else self._given_up(job, start, done)
            )
            if attempt.is_kept:
                self._counts.saved += 1
            else:
                self._counts.failures[str(attempt.about["end"])] += 1
            return attempt

    def _rollout(self, start: RolloutStart) -> tuple[Control, Rollout | None]:
        """Run a rollout, and return what the person decides, and the rollout unless it was ended before its end."""
        opened = self._opened
        try:
            done = rollout(opened.task, start, self._teleoperator, opened.world, opened.judge, watch=self._view.show)
        except AttemptEndedError as ended:
            return ended.control, None
        self._counts.digests.append(done.digest)
        return self._decision(done), done

    def _decision(self, done: Rollout) -> Control:
        """Wait until the person decides about a rollout that has ended. A stream that has ended saves what it can."""
        view = self._view
        if done.success:
            view.tell(f"Success after {done.steps} steps. Save or discard it, or try again.", is_over=True)
        else:
            view.tell(f"The attempt has ended: {done.reason}. Try again, or discard it.", is_over=True)
        while True:
            events = self._source.decide()
            if events is None:
                return Control.SAVE if done.success else Control.DISCARD
            for control in self._teleoperator.controls(events):
                if control in (Control.DISCARD, Control.RETRY, Control.QUIT) or (
                    control is Control.SAVE and done.success
                ):
                    return control
                if control is Control.SAVE:
                    view.tell(
                        "Only a rollout that reaches the goal can be saved. Try again, or discard it.", is_over=True
                    )

    def _saved(self, job: AttemptJob, start: RolloutStart, done: Rollout) -> Attempt:
        """Return the attempt of a rollout that is saved, after its replay."""
        self._view.tell("Verifying the demonstration by a replay …")
        found = verified_attempt(job, start, done, self._teleoperator.action_space, self._extra())
        if found.about["end"] == NOT_REPRODUCED:
            self._view.tell("The replay was not identical, so the demonstration was not kept.")
        return found

    def _given_up(self, job: AttemptJob, start: RolloutStart, done: Rollout | None) -> Attempt:
        """Return the attempt of a rollout that is not saved."""
        if done is not None:
            facts: dict[str, Any] = attempt_facts(job, start, done)
            if done.success:
                facts |= {"success": False, "end": DISCARDED, "reason": "the person did not save it"}
            return Attempt({**facts, **self._extra()})
        cells = {name: list(cell) for name, cell in start.cells.items()}
        facts = {"index": job.index, "seed": job.seed, "cells": cells, "start": start.digest, "success": False}
        ended = {"kept": False, "end": DISCARDED, "reason": "the person gave up the attempt"}
        return Attempt({**facts, **ended, "steps": self._step(self._teleoperator.status.step), **self._extra()})

    def _extra(self) -> dict[str, Any]:
        """Return what only teleoperation knows about an attempt: the device, and the control step at each mark."""
        names, marks = list(self._opened.task.subtasks), self._teleoperator.status.marks
        named = [{"name": names[k] if k < len(names) else "", "step": self._step(at)} for k, at in enumerate(marks)]
        return {"device": self._teleoperator.device.name, "marks": named}

    def _step(self, action: int) -> int:
        """Return the number of control steps that have begun before an action."""
        return math.ceil(action * self._opened.task.control_hz / self._teleoperator.action_hz)


def check_valid(teleoperator: Teleoperator) -> None:
    """Ensure that a stream contains valid packets.

    Raises:
        SimfoundryError: If it contains none, but invalid ones.
    """
    device = teleoperator.device
    if device.heard_at is None and device.refused:
        reason, count = device.refused.most_common(1)[0]
        raise SimfoundryError(
            f"the {device.title} sent no valid packet; {sum(device.refused.values())} were refused, {count} of them "
            f"because {reason}"
        )
