"""The plan of a recording, which determines the task and the initial state of every attempt."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from simfoundry.data.attempt import AttemptJob
from simfoundry.evaluate.entries import Contender


@dataclass(frozen=True)
class RecordPlan:
    """The demonstrations to record.

    The attempts take turns: with T tasks, attempt k belongs to task k mod T and starts from its initial state k // T.

    Attributes:
        folder: The output folder.
        documents: The task documents, in the order in which they take turns.
        contender: The policy.
        count: The number of demonstrations.
        max_attempts: The maximum number of attempts, including successful ones.
        seed: The seed for the initial states.
        source: The folder of the demonstrations that are augmented, or None.
    """

    folder: Path
    documents: tuple[Path, ...]
    contender: Contender
    count: int
    max_attempts: int
    seed: int = 0
    source: Path | None = None

    def name(self, document: Path) -> str:
        """Return the path of a task document relative to the folder."""
        return Path(os.path.relpath(document.resolve(), self.folder.resolve())).as_posix()

    def job(self, index: int) -> AttemptJob:
        """Return an attempt."""
        start, turn = divmod(index, len(self.documents))
        document = self.documents[turn]
        name = self.name(document) if len(self.documents) > 1 else ""
        return AttemptJob(index, document, name, self.contender, self.seed, start)


@dataclass(frozen=True)
class RecordSummary:
    """The state of a recording.

    Attributes:
        kept: The number of demonstrations in the folder.
        attempts: The number of finished attempts.
        failures: The number of other attempts by the reason why they ended.
        reasons: The reason of the first attempt with each of these ends.
        not_reproduced: The indices of successful attempts whose replay differed.
    """

    kept: int
    attempts: int
    failures: Mapping[str, int]
    reasons: Mapping[str, str]
    not_reproduced: tuple[int, ...]
