"""The models that are configured: in ``simfoundry.yaml`` of a project, and in environment variables, which win.

For each task, ``SIMFOUNDRY_MODEL_<TASK>`` is the URL of a server, ``offline``, ``recorded:FOLDER`` or
``command:PROGRAM ARGUMENTS``. ``SIMFOUNDRY_MODEL_TOKEN`` is the bearer token of the servers given in this way.
"""

from __future__ import annotations

import os
import shlex
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import get_args

from simfoundry.models.client import ModelClient, Transport
from simfoundry.models.contract import ModelError
from simfoundry.models.transports.http import TIMEOUT_S, HttpTransport
from simfoundry.models.transports.process import ProcessTransport
from simfoundry.models.transports.recorded import RecordedTransport
from simfoundry.spec.models.model_sources import ModelSource, ModelTaskName
from simfoundry.spec.project import MARKER, find_project

# Folders of projects whose commands may be started, separated like the entries of PATH.
TRUST = "SIMFOUNDRY_TRUST"

# Bearer token of servers whose URL is in the environment.
TOKEN = "SIMFOUNDRY_MODEL_TOKEN"

# Set to 1 to refuse models that may not be used commercially.
COMMERCIAL_ONLY = "SIMFOUNDRY_COMMERCIAL_ONLY"

TASK_NAMES: tuple[ModelTaskName, ...] = get_args(ModelTaskName)


def variable(task: str) -> str:
    """Return the name of the environment variable with the source for a task."""
    return f"SIMFOUNDRY_MODEL_{task.upper()}"


@dataclass(frozen=True)
class ModelSetup:
    """The configured models.

    Attributes:
        root: Folder that relative paths refer to.
        sources: Source for each task, and the place where it is configured.
        commercial_only: Whether to refuse models that may not be used commercially.
        accepted: Models whose conditions for commercial use were accepted.
        environment: Environment variables.
    """

    root: Path
    sources: Mapping[str, tuple[ModelSource, str]] = field(default_factory=dict)
    commercial_only: bool = False
    accepted: tuple[str, ...] = ()
    environment: Mapping[str, str] = field(default_factory=dict, repr=False)

    def source(self, task: str) -> ModelSource | None:
        """Return the source for a task, or None if none is configured."""
        return self.sources[task][0] if task in self.sources else None

    def without(self, task: str) -> ModelSetup:
        """Return the setup without the model for a task, so that its offline method is used."""
        return replace(self, sources={each: source for each, source in self.sources.items() if each != task})

    def client(self, task: str) -> ModelClient:
        """Return the client of the server, command or recording behind a task.

        Raises:
            ModelError: If none is configured or it may not be used.
        """
        source = self.source(task)
        if source is None:
            raise ModelError(
                f"no model for `{task}` is configured: set {variable(task)} to the URL of a server, or add `{task}` "
                f"under `models: tasks:` in {MARKER}"
            )
        record = None if source.record is None else self.path(source.record)
        return ModelClient(self._transport(task, source), self.commercial_only, self.accepted, record)

    def path(self, relative: str) -> Path:
        """Return the path of a file or folder in the project.

        Raises:
            ModelError: If it lies outside of the project.
        """
        path = (self.root / relative).resolve()
        if not path.is_relative_to(self.root.resolve()):
            raise ModelError(
                f"`{relative}` in {self.root / MARKER} lies outside of the project; move it into {self.root}"
            )
        return path

    def _transport(self, task: str, source: ModelSource) -> Transport:
        limit_s = source.timeout_s or TIMEOUT_S
        if source.url is not None:
            return HttpTransport(source.url, self._token(source), limit_s)
        if source.command is not None:
            self._require_trust(task, source)
            return ProcessTransport(source.command, limit_s)
        if source.recorded is not None:
            is_given = self.sources[task][1] == variable(task)
            return RecordedTransport(Path(source.recorded) if is_given else self.path(source.recorded))
        if source.weights is not None:
            from simfoundry.models.onnx.adapters import open_network

            return open_network(task, source.adapter or "", self.path(source.weights))
        kind = "a provider's model" if source.vlm is not None else "the offline method"
        raise ModelError(f"`{task}` is configured to use {kind}, which is not reached by bundles")

    def _token(self, source: ModelSource) -> str:
        if source.token is None:
            return ""
        token = self.environment.get(source.token, "")
        if not token:
            raise ModelError(f"the token for {source.url} is missing: set the environment variable {source.token}")
        return token

    def _require_trust(self, task: str, source: ModelSource) -> None:
        """Ensure that a command was written by the user, not only by the author of a project."""
        if self.sources[task][1] == variable(task):
            return
        trusted = [Path(folder).resolve() for folder in self.environment.get(TRUST, "").split(os.pathsep) if folder]
        if self.root.resolve() not in trusted:
            raise ModelError(
                f"the model for `{task}` is a program that {self.root / MARKER} starts "
                f"(`{shlex.join(source.command or ())}`); if you trust this project, set {TRUST}={self.root}"
            )


def load_setup(
    path: Path | None = None, environment: Mapping[str, str] | None = None, commercial_only: bool = False
) -> ModelSetup:
    """Return the models that are configured for a file or folder.

    Args:
        path: A file or folder, by default the working folder, whose project is consulted.
        environment: Environment variables, by default those of this process.
        commercial_only: Whether to refuse models that may not be used commercially, whatever the project says.

    Raises:
        SpecError: If ``simfoundry.yaml`` cannot be read.
        ModelError: If an environment variable cannot be read.
    """
    env = os.environ if environment is None else environment
    project = find_project(path or Path.cwd())
    root = project.root if project is not None else Path.cwd()
    setup = ModelSetup(
        root, environment=env, commercial_only=commercial_only or env.get(COMMERCIAL_ONLY, "") not in ("", "0")
    )
    if project is not None:
        models = project.spec.models
        listed = {str(task): (source, str(project.marker)) for task, source in models.tasks.items()}
        either = setup.commercial_only or models.commercial_only
        setup = replace(setup, sources=listed, accepted=models.accepted, commercial_only=either)
    given: dict[str, tuple[ModelSource, str]] = {
        task: (_parsed(task, env[variable(task)], env), variable(task))
        for task in TASK_NAMES
        if env.get(variable(task))
    }
    return replace(setup, sources={**setup.sources, **given})


def _parsed(task: str, text: str, environment: Mapping[str, str]) -> ModelSource:
    """Return the source that an environment variable describes."""
    kind, _, rest = text.partition(":")
    if text.startswith(("http://", "https://")):
        return ModelSource(url=text, token=TOKEN if environment.get(TOKEN) else None)
    if text == "offline":
        return ModelSource(offline=True)
    if kind == "recorded" and rest:
        return ModelSource(recorded=rest)
    if kind == "command" and rest.strip():
        try:
            return ModelSource(command=tuple(shlex.split(rest)))
        except ValueError as error:
            raise ModelError(f"the command in {variable(task)} cannot be split into arguments: {error}") from None
    raise ModelError(
        f"{variable(task)} must be the URL of a server, `offline`, `recorded:FOLDER` or `command:PROGRAM ARGUMENTS`"
    )
