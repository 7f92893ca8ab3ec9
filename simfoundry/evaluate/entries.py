"""Entries of an evaluation: tasks, complete or from a given step, and the policies evaluated on each."""

from __future__ import annotations

import hashlib
import re
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from simfoundry.assets.cache import Cache
from simfoundry.errors import SimfoundryError
from simfoundry.evaluate.policies.choice import Choice, ReplayChoice, parse_policy
from simfoundry.evaluate.policies.python_class import PythonClass
from simfoundry.evaluate.tasks.task import Task, load_task

_LABELED = re.compile(r"([a-z][a-z0-9_.-]*)=(.+)", re.DOTALL)
_UNFIT = re.compile(r"[^A-Za-z0-9_.-]+")


class TaskPart(StrEnum):
    """The part of a task that is evaluated: the whole, a single step, or everything from a step on."""

    WHOLE = "whole"
    ALONE = "alone"
    ONWARD = "onward"


@dataclass(frozen=True)
class TaskEntry:
    """A task of an evaluation: its document, and the ``step`` unless the whole is evaluated."""

    path: Path
    part: TaskPart = TaskPart.WHOLE
    step: str = ""

    def load(self, cache: Cache | None = None) -> Task:
        """Load the task, or the selected part of it."""
        task = load_task(self.path, cache)
        if self.part is TaskPart.WHOLE:
            return task
        return task.alone(self.step) if self.part is TaskPart.ALONE else task.onward(self.step)


@dataclass(frozen=True)
class Contender:
    """A policy of an evaluation: its ``label`` in reports, and the text that selects it."""

    label: str
    text: str

    def choice(self) -> Choice:
        """Parse the text; raises :class:`PolicyError` or :class:`SpecError`."""
        return parse_policy(self.text)

    @property
    def digest(self) -> str:
        """Return a digest of the selection, including the content of its document or recording."""
        choice = self.choice()
        if isinstance(choice, PythonClass):
            return choice.digest
        said = choice.path.read_bytes() if isinstance(choice, ReplayChoice) else repr(choice).encode()
        return hashlib.sha256(said).hexdigest()[:16]


def contenders(texts: tuple[str, ...]) -> list[Contender]:
    """Parse texts of the form ``POLICY`` or ``LABEL=POLICY``; labels must be unique."""
    found: list[Contender] = []
    for text in texts:
        match = _LABELED.fullmatch(text)
        label, policy = match.groups() if match else (_label(text), text)
        if any(label == other.label for other in found):
            raise SimfoundryError(f"two policies have the label `{label}`; give one another label: `NAME={policy}`")
        one = Contender(label, policy)
        choice = one.choice()  # report an invalid policy now and not after an hour
        if isinstance(choice, PythonClass):
            choice.find()
        found.append(one)
    return found


def _label(text: str) -> str:
    word = text
    if text.endswith((".yaml", ".yml")):
        word = Path(text).name.partition(".")[0]
    elif text.startswith("python:"):
        word = text.partition("?")[0].rpartition(":")[2]
    elif ":" in text:
        word = text.partition("?")[0]
    return _UNFIT.sub("-", word).strip("-.") or "policy"
