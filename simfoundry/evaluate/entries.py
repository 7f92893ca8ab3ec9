"""Parsing of the tasks and policies that users select for an evaluation.

A task is evaluated as a whole, as a single step, or from a given step onward. A policy is selected by a keyword, a
server address, a document, a recording, or a Python class.
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
from simfoundry.evaluate.policies.checkpoint import LOADERS, CheckpointChoice
from simfoundry.evaluate.policies.python_class import PythonClass, PythonPolicy
from simfoundry.evaluate.task import Task, load_task
from simfoundry.predicates import Judge
from simfoundry.spec.load import load_kind
from simfoundry.spec.models.policy import PROTOCOLS, PolicySpec


@dataclass(frozen=True)
class ExpertChoice:
    """The scripted expert, which is created separately for each task.

    ``noise`` is the standard deviation of the joint noise on its way through free space [rad or m].
    """

    noise: float = 0.0


@dataclass(frozen=True)
class RandomChoice:
    """A policy that moves the robots at random."""


@dataclass(frozen=True)
class ReplayChoice:
    """A policy that replays recorded actions."""

    path: Path


# A selected policy that has not been created yet.
Choice = PolicySpec | ExpertChoice | RandomChoice | ReplayChoice | CheckpointChoice | PythonClass

# The content of the folder of each kind of policy that is stored in one, and a name of such a folder, for messages.
_FOLDERS = {"augment": ("demonstrations", "demos"), "baseline": ("a trained policy", "build/train/policy")}

# Largest standard deviation of the expert's joint noise [rad or m]: 0.02 moves a hand by about 1 cm, which is half of
# the clearance that the planner prefers.
MOST_EXPERT_NOISE = 0.02

# Policies that are created separately for each task.
TASK_CHOICES = (ExpertChoice, CheckpointChoice)


def parse_policy(text: str) -> Choice:
    """Parse the text that selects a policy.

    The text is one of the following:

    - ``random``, or ``expert``, optionally followed by its noise as ``?noise=0.01``
    - ``replay:FILE``
    - ``baseline:FOLDER``, or ``augment:DEMOS``, optionally followed by options as ``?name=value&…``
    - ``python:MODULE:CLASS`` or ``python:FILE.py:CLASS``, optionally followed by arguments as ``?name=value&…``
    - the path of a ``*.policy.yaml`` document
    - a server in short form, such as ``openpi:localhost:8000?action_space=joint_position&horizon=8``, which uses
      DROID's cameras (the query accepts every policy document key whose value is a single word or number)

    Raises:
        PolicyError: If the text does not select a policy.
        SpecError: If the policy document is invalid.
    """
    if text in ("random", "expert"):
        return RandomChoice() if text == "random" else ExpertChoice()
    if text.startswith("expert?"):
        return _expert(text.removeprefix("expert?"))
    kind, _, rest = text.partition(":")
    if kind == "teleop":
        raise PolicyError("people act only in `simfoundry teleop`, which records demonstrations")
    if kind == "replay":
        if not rest:
            raise PolicyError("`replay` requires a recording, such as `replay:rollout.npz`")
        return ReplayChoice(Path(rest))
    if kind in LOADERS:
        if not rest:
            content, example = _FOLDERS[kind]
            raise PolicyError(f"`{kind}` requires the folder of {content}, such as `{kind}:{example}`")
        return _checkpoint(kind, rest)
    if kind == "python":
        return _python(rest)
    if text.endswith((".yaml", ".yml")):
        spec = load_kind(Path(text), "policy/1").spec
        assert isinstance(spec, PolicySpec)
        return spec
    if kind in PROTOCOLS:
        return _short(kind, rest)
    folders = ", ".join(f"`{one}:FOLDER`" for one in LOADERS)
    words = f"`random`, `expert`, `replay:FILE`, {folders}, `python:MODULE:CLASS`, a path to a .policy.yaml"
    servers = " or ".join(f"`{protocol}:ADDRESS?action_space=…`" for protocol in PROTOCOLS.names())
    raise PolicyError(f"`{text}` is not a valid policy; use {words}, or a server such as {servers}")


def open_policy(choice: PolicySpec | RandomChoice | ReplayChoice | PythonClass) -> Policy:
    """Create a selected policy.

    This function does not create the policies in :data:`TASK_CHOICES`, which also require the task. A policy behind a
    server connects when its first rollout starts.
    """
    if isinstance(choice, RandomChoice):
        from simfoundry.evaluate.policies.open_loop import RandomPolicy

        return RandomPolicy()
    if isinstance(choice, ReplayChoice):
        from simfoundry.evaluate.policies.open_loop import load_replay

        return load_replay(choice.path)
    if isinstance(choice, PythonClass):
        return PythonPolicy(choice)
    policy: Policy = PROTOCOLS.running(choice.protocol, PolicyError)(PROTOCOLS.load(choice.protocol).open)(choice)
    return policy


def create_policy(choice: Choice, task: Task, judge: Judge) -> Policy:
    """Create any selected policy for a task."""
    if isinstance(choice, CheckpointChoice):
        return choice.create(task)
    if isinstance(choice, ExpertChoice):
        from simfoundry.evaluate.expert.policy import ExpertPolicy

        return ExpertPolicy(task, judge, choice.noise)
    return open_policy(choice)


def _expert(query: str) -> ExpertChoice:
    said = dict(_arguments(query, "expert", "?noise=0.01"))
    noise = said.pop("noise", 0.0)
    if said:
        raise PolicyError(f"`expert` has no option `{next(iter(said))}`; its only option is `noise`")
    if isinstance(noise, str) or not 0 <= noise <= MOST_EXPERT_NOISE:
        raise PolicyError(f"`noise` of `expert` must be between 0 and {MOST_EXPERT_NOISE:g} rad, not {noise}")
    return ExpertChoice(float(noise))


def _python(rest: str) -> PythonClass:
    path, _, query = rest.partition("?")
    module, _, name = path.rpartition(":")
    if not module or not name.isidentifier():
        raise PolicyError(f"`python:{rest}` does not name a class; use `python:MODULE:CLASS` or `python:FILE.py:CLASS`")
    return PythonClass(module, name, _arguments(query, name, "?checkpoint=last.pt&horizon=8"))


def _checkpoint(kind: str, rest: str) -> CheckpointChoice:
    folder, _, query = rest.partition("?")
    return CheckpointChoice(kind, Path(folder), _arguments(query, kind, "?noise=0.01"))


def _arguments(query: str, name: str, example: str) -> tuple[tuple[str, str | int | float], ...]:
    """Parse the arguments of a policy, such as ``checkpoint=last.pt&horizon=8``."""
    said = parse_qsl(query, keep_blank_values=True)
    if not all(key.isidentifier() for key, _ in said) or len(dict(said)) < len(said):
        raise PolicyError(
            f"`{query}` does not contain valid arguments for `{name}`; specify each argument once, such as `{example}`"
        )
    return tuple((key, _value(value)) for key, value in said)


def _short(protocol: str, rest: str) -> PolicySpec:
    """Convert a server in short form to an equivalent policy document."""
    from pydantic import ValidationError

    address, _, query = rest.partition("?")
    said = {key: _value(value) for key, value in parse_qsl(query, keep_blank_values=True)}
    if "action_space" not in said:
        full = f"{protocol}:{address or 'localhost'}?action_space=joint_position"
        reason = "the protocol does not specify whether actions are joint positions or velocities"
        raise PolicyError(f"{reason}; use `{full}` or `…=joint_velocity`, or write a policy document")
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
    """Convert digits to a number and `true` or `false` to a boolean.

    Any other text is returned unchanged. For example, `nan` remains text because it may be a name.
    """
    if text in ("true", "false"):
        return text == "true"
    if not re.fullmatch(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?", text):
        return text
    return int(text) if text.lstrip("+-").isdigit() else float(text)


_LABELED = re.compile(r"([a-z][a-z0-9_.-]*)=(.+)", re.DOTALL)
_UNFIT = re.compile(r"[^A-Za-z0-9_.-]+")


class TaskPart(StrEnum):
    """The part of a task to evaluate: the whole task, a single step, or everything from a step onward."""

    WHOLE = "whole"
    ALONE = "alone"
    ONWARD = "onward"


@dataclass(frozen=True)
class TaskEntry:
    """A task to evaluate, given by its document.

    ``step`` is set if only a part of the task is evaluated.
    """

    path: Path
    part: TaskPart = TaskPart.WHOLE
    step: str = ""

    def load(self, cache: Cache | None = None) -> Task:
        """Load the task or the selected part of it."""
        task = load_task(self.path, cache)
        if self.part is TaskPart.WHOLE:
            return task
        return task.alone(self.step) if self.part is TaskPart.ALONE else task.onward(self.step)


@dataclass(frozen=True)
class Contender:
    """A policy to evaluate. ``label`` is its name in reports, and ``text`` selects it."""

    label: str
    text: str

    def choice(self) -> Choice:
        """Parse the text that selects the policy.

        See :func:`parse_policy`.
        """
        return parse_policy(self.text)

    @property
    def is_foreign(self) -> bool:
        """True if the policy runs code of others, which can crash or hang, in the process of the rollout."""
        return isinstance(self.choice(), PythonClass)

    @property
    def digest(self) -> str:
        """A digest of the selected policy.

        It covers the content of the policy's document, recording or folder.
        """
        choice = self.choice()
        if isinstance(choice, PythonClass | CheckpointChoice):
            return choice.digest
        said = choice.path.read_bytes() if isinstance(choice, ReplayChoice) else repr(choice).encode()
        return hashlib.sha256(said).hexdigest()[:16]


def contenders(texts: tuple[str, ...]) -> list[Contender]:
    """Parse texts of the form ``POLICY`` or ``LABEL=POLICY``. Each label must be unique."""
    found: list[Contender] = []
    for text in texts:
        match = _LABELED.fullmatch(text)
        label, policy = match.groups() if match else (_label(text), text)
        if any(label == other.label for other in found):
            raise SimfoundryError(
                f"two policies have the label `{label}`; choose a different label for one of them: `NAME={policy}`"
            )
        one = Contender(label, policy)
        choice = one.choice()  # report an invalid policy immediately rather than after an hour
        if isinstance(choice, PythonClass):
            choice.find()
        if isinstance(choice, CheckpointChoice):
            _ = choice.digest
        if isinstance(choice, ReplayChoice):
            open_policy(choice)
        found.append(one)
    return found


def _label(text: str) -> str:
    word = text.partition("?")[0] if ":" in text else text
    if (kind := text.partition(":")[0]) in LOADERS:
        return kind
    if text.endswith((".yaml", ".yml")):
        word = Path(text).name.partition(".")[0]
    elif text.startswith("python:"):
        word = word.rpartition(":")[2]
    return _UNFIT.sub("-", word).strip("-.") or "policy"


class OpenPolicies:
    """The policies that are open in a process. They stay open across tasks, except experts, which belong to a task."""

    def __init__(self) -> None:
        self._open: dict[tuple[Task | None, str], Policy] = {}

    def policy(self, contender: Contender, task: Task, judge: Judge) -> Policy:
        """Return the policy for a task, which is created on first use. Those of other tasks are closed."""
        choice = contender.choice()
        key = (task if isinstance(choice, TASK_CHOICES) else None, contender.text)
        if key not in self._open:
            for stale in [k for k in self._open if k[0] is not None and k[0] is not task]:
                self._open.pop(stale).close()
            self._open[key] = create_policy(choice, task, judge)
        return self._open[key]

    def close(self) -> None:
        """Close all policies."""
        while self._open:
            self._open.popitem()[1].close()
