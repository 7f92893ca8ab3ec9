"""Entries of an evaluation as users select them: tasks, complete or from a given step, and policies.

A policy is a word, a server, a document, a recording, or a Python class.
"""

from __future__ import annotations

import hashlib
import re
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any
from urllib.parse import parse_qsl

from simfoundry.assets.cache import Cache
from simfoundry.errors import SimfoundryError
from simfoundry.evaluate.policies.base import Policy, PolicyError
from simfoundry.evaluate.policies.python_class import PythonClass, PythonPolicy
from simfoundry.evaluate.task import Task, load_task
from simfoundry.spec.models.policy import PROTOCOLS, PolicySpec


@dataclass(frozen=True)
class ExpertChoice:
    """The scripted expert, which is created with its task."""


@dataclass(frozen=True)
class RandomChoice:
    """Random motion."""


@dataclass(frozen=True)
class ReplayChoice:
    """Replay of the actions of a recording."""

    path: Path


Choice = PolicySpec | ExpertChoice | RandomChoice | ReplayChoice | PythonClass
"""A selected policy that has not been created yet."""


def parse_policy(text: str) -> Choice:
    """Parse the text that selects a policy; raises :class:`PolicyError`, or ``SpecError`` for a bad document.

    ``random``, ``expert``, ``replay:FILE``, ``python:MODULE:CLASS`` (or ``python:FILE.py:CLASS``; arguments follow as
    ``?name=value&…``), a path to a ``*.policy.yaml``, or a server in short form,
    ``openpi:localhost:8000?action_space=joint_position&horizon=8``: the keys are those of a policy document that take a
    single word or number; the cameras are those of DROID.
    """
    if text in ("random", "expert"):
        return RandomChoice() if text == "random" else ExpertChoice()
    kind, _, rest = text.partition(":")
    if kind == "replay":
        if not rest:
            raise PolicyError("name the recording to replay, such as `replay:rollout.npz`")
        return ReplayChoice(Path(rest))
    if kind == "python":
        return _python(rest)
    if text.endswith((".yaml", ".yml")):
        return _document(Path(text))
    if kind in PROTOCOLS:
        return _short(kind, rest)
    words = "`random`, `expert`, `replay:FILE`, `python:MODULE:CLASS`, a path to a .policy.yaml"
    servers = " or ".join(f"`{protocol}:ADDRESS?action_space=…`" for protocol in PROTOCOLS.names())
    raise PolicyError(f"`{text}` is not a policy: give {words}, or a server, {servers}")


def open_policy(choice: PolicySpec | RandomChoice | ReplayChoice | PythonClass) -> Policy:
    """Create a selected policy, which connects at its first rollout; the expert is created with its task."""
    if isinstance(choice, RandomChoice):
        from simfoundry.evaluate.policies.open_loop import RandomPolicy

        return RandomPolicy()
    if isinstance(choice, ReplayChoice):
        from simfoundry.evaluate.policies.open_loop import load_replay

        return load_replay(choice.path)
    if isinstance(choice, PythonClass):
        return PythonPolicy(choice)
    policy: Policy = PROTOCOLS.load(choice.protocol).open(choice)
    return policy


def _python(rest: str) -> PythonClass:
    path, _, query = rest.partition("?")
    module, _, name = path.rpartition(":")
    if not module or not name.isidentifier():
        raise PolicyError(f"`python:{rest}` names no class; write `python:MODULE:CLASS` or `python:FILE.py:CLASS`")
    said = parse_qsl(query, keep_blank_values=True)
    wrong = next((key for key, _ in said if not key.isidentifier()), None)
    if wrong is not None or len({key for key, _ in said}) < len(said):
        raise PolicyError(
            f"`{query}` are not valid arguments of `{name}`; write each once, such as `?checkpoint=last.pt&horizon=8`"
        )
    return PythonClass(module, name, tuple((key, _value(value)) for key, value in said))


def _document(path: Path) -> PolicySpec:
    from simfoundry.spec.load import load_kind

    spec = load_kind(path, "policy/1").spec
    assert isinstance(spec, PolicySpec)
    return spec


def _short(protocol: str, rest: str) -> PolicySpec:
    """Parse a server's short form as an equivalent policy document."""
    from pydantic import ValidationError

    address, _, query = rest.partition("?")
    said = {key: _value(value) for key, value in parse_qsl(query, keep_blank_values=True)}
    if "action_space" not in said:
        full = f"{protocol}:{address or 'localhost'}?action_space=joint_position"
        reason = "the protocol does not transmit the meaning of the arm's numbers"
        raise PolicyError(f"{reason}: write `{full}` or `…=joint_velocity`, or write a policy document")
    whole: dict[str, Any] = {
        "simfoundry": "policy/1",
        "name": protocol,
        "protocol": protocol,
        "address": address or "localhost",
        "horizon": 8,
        **PROTOCOLS.load(protocol).short_form,
    }
    try:
        return PolicySpec.model_validate(whole | said)
    except ValidationError as error:
        first = error.errors()[0]
        at = ".".join(map(str, first["loc"]))
        raise PolicyError(f"`{protocol}:{rest}`: {f'`{at}`: ' if at else ''}{first['msg']}") from None


def _value(text: str) -> str | int | float:
    """Parse a number written in digits, or `true` and `false`; otherwise keep the text, because `nan` may be a name."""
    if text in ("true", "false"):
        return text == "true"
    if re.fullmatch(r"[+-]?[0-9]+", text):
        return int(text)
    return float(text) if re.fullmatch(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?", text) else text


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
