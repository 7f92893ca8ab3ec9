"""Policies as users name them: a word, a server, a document, a recording, a Python class."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import parse_qsl

from simfoundry.evaluate.policies.base import Policy, PolicyError
from simfoundry.evaluate.policies.python_class import PythonClass, PythonPolicy
from simfoundry.spec.models.policy import PROTOCOLS, PolicySpec


@dataclass(frozen=True)
class ExpertChoice:
    """The scripted expert, which is made with its task."""


@dataclass(frozen=True)
class RandomChoice:
    """Random motion."""


@dataclass(frozen=True)
class ReplayChoice:
    """The actions of a recording."""

    path: Path


Choice = PolicySpec | ExpertChoice | RandomChoice | ReplayChoice | PythonClass
"""A policy that was chosen and is not yet made."""


def parse_policy(text: str) -> Choice:
    """The policy that a text means; raises :class:`PolicyError` with a sentence, ``SpecError`` for a bad document.

    ``random``, ``expert``, ``replay:FILE``, ``python:MODULE:CLASS`` (or ``python:FILE.py:CLASS``; arguments follow as
    ``?name=value&…``), a path to a ``*.policy.yaml``, or a server in short,
    ``openpi:localhost:8000?action_space=joint_position&horizon=8``: the keys are those of a policy document, as far as
    they hold one word or number; the cameras are those of DROID.
    """
    if text in ("random", "expert"):
        return RandomChoice() if text == "random" else ExpertChoice()
    kind, _, rest = text.partition(":")
    if kind == "replay":
        if not rest:
            raise PolicyError("say which recording is replayed, as `replay:rollout.npz`")
        return ReplayChoice(Path(rest))
    if kind == "python":
        return _python(rest)
    if text.endswith((".yaml", ".yml")):
        return _document(Path(text))
    if kind in PROTOCOLS:
        return _short(kind, rest)
    words = "`random`, `expert`, `replay:FILE`, `python:MODULE:CLASS`, a path to a .policy.yaml"
    servers = " or ".join(f"`{protocol}:ADDRESS?action_space=…`" for protocol in PROTOCOLS.names())
    raise PolicyError(f"`{text}` is no policy: give {words}, or a server, {servers}")


def open_policy(choice: PolicySpec | RandomChoice | ReplayChoice | PythonClass) -> Policy:
    """The policy that was chosen, connected to nothing before its first rollout; the expert is made with its task."""
    if isinstance(choice, RandomChoice):
        from simfoundry.evaluate.policies.random_walk import RandomPolicy

        return RandomPolicy()
    if isinstance(choice, ReplayChoice):
        from simfoundry.evaluate.policies.replay import load_replay

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
            f"`{query}` are no arguments of `{name}`; write each once, as `?checkpoint=last.pt&horizon=8`"
        )
    return PythonClass(module, name, tuple((key, _value(value)) for key, value in said))


def _document(path: Path) -> PolicySpec:
    from simfoundry.spec.load import load_kind

    spec = load_kind(path, "policy/1").spec
    assert isinstance(spec, PolicySpec)
    return spec


def _short(protocol: str, rest: str) -> PolicySpec:
    """A server with what follows its address, as a document would say it."""
    from pydantic import ValidationError

    address, _, query = rest.partition("?")
    said = {key: _value(value) for key, value in parse_qsl(query, keep_blank_values=True)}
    if "action_space" not in said:
        full = f"{protocol}:{address or 'localhost'}?action_space=joint_position"
        reason = "what the arm's numbers mean is not on the wire"
        raise PolicyError(f"{reason}: say `{full}` or `…=joint_velocity`, or write a policy document")
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
    """A number where it is written as one, in digits; `true` and `false`; else the text: `nan` may be a name."""
    if text in ("true", "false"):
        return text == "true"
    if re.fullmatch(r"[+-]?[0-9]+", text):
        return int(text)
    return float(text) if re.fullmatch(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?", text) else text
