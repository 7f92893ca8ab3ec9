"""Client of models: sends a request as a bundle, and returns only answers that keep the contract of their task."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from pydantic import BaseModel

from simfoundry.models.contract import ConventionError, ModelError, ModelTask, check_answer, check_request, plain
from simfoundry.models.provenance import ModelIdentity, read_identity, require_commercial
from simfoundry.models.transports.recorded import read_recording, recording
from simfoundry.models.wire import ANSWER, REQUEST, VERSION, Bundle, BundleError, Content, read_bundle, write_bundle
from simfoundry.runtime.files import write_atomically

# Members of a request by name; those that are None are not sent.
Members = dict[str, Content | None]

SEEDS = 2**32  # Exclusive upper bound on seeds that every model accepts


class Transport(Protocol):
    """A way to a model: HTTP, a process, or recorded answers."""

    @property
    def place(self) -> str:
        """The address for messages, without secrets."""

    def exchange(self, task: str, digest: str, data: bytes) -> bytes:
        """Send the request ``data`` with the given digest, and return the answer's bytes, which are not trusted.

        Raises:
            ModelError: If there is no answer.
        """

    def describe(self) -> Mapping[str, Any]:
        """Return the tasks, models and licences of the server, which are not trusted.

        Raises:
            ModelError: If the server does not answer.
        """


@dataclass(frozen=True, eq=False)
class ModelAnswer:
    """A checked answer.

    Attributes:
        bundle: The answer.
        made_by: The model that answered.
        confidence: Confidence of the model in the whole answer, 0 to 1, or None.
        warnings: Remarks of the model.
    """

    bundle: Bundle
    made_by: ModelIdentity
    confidence: float | None
    warnings: tuple[str, ...]

    def array(self, name: str) -> Any:
        """Return an array of the answer."""
        return self.bundle.members[name]

    def optional(self, name: str) -> Any:
        """Return an array of the answer, or None if the model did not send it."""
        return self.bundle.members.get(name)


@dataclass(frozen=True)
class ModelClient:
    """A model that is reached over a transport.

    Attributes:
        transport: The way to the model.
        commercial_only: Whether to refuse answers of models that may not be used commercially.
        accepted: Names of models whose condition on commercial use the user has accepted.
        record: Folder in which answers are recorded and looked up first, or None. Only checked answers are recorded.
    """

    transport: Transport
    commercial_only: bool = False
    accepted: tuple[str, ...] = field(default=())
    record: Path | None = None

    def ask(self, task: ModelTask, members: Members, parameters: BaseModel | None = None, seed: int = 0) -> ModelAnswer:
        """Solve a task.

        Args:
            task: The task.
            members: Members of the request; those that are None are not sent.
            parameters: Parameters of the task.
            seed: Seed of the model's random choices.

        Raises:
            ModelError: If the model does not answer, or if the answer breaks the contract.
        """
        plain = {} if parameters is None else parameters.model_dump(mode="json", exclude_none=True)
        head = {"bundle": VERSION, "task": task.name, "parameters": plain, "seed": seed % SEEDS}
        request = Bundle(head, {name: content for name, content in members.items() if content is not None}, notes(task))
        try:
            check_request(task, request)
            sent = write_bundle(request, REQUEST)
        except (BundleError, ConventionError) as error:
            raise ModelError(f"the request for `{task.name}` {error}") from None
        digest = request.digest
        kept = None if self.record is None else recording(self.record, digest)
        if kept is not None and kept.is_file():
            return self._checked(task, request, read_recording(kept), str(kept))
        if self.commercial_only:
            self._require_commercial(task)
        received = self.transport.exchange(task.name, digest, sent)
        answer = self._checked(task, request, received, self.transport.place)
        if kept is not None:
            write_atomically(kept, received)
        return answer

    def _require_commercial(self, task: ModelTask) -> None:
        """Ask the server which model it runs, so that nothing is sent to one that may not be used."""
        for identity in identities(self.transport.describe(), task.name):
            self._judge(identity)

    def _judge(self, identity: ModelIdentity) -> None:
        try:
            require_commercial(identity, self.accepted)
        except ModelError as error:
            raise ModelError(f"{error} ({self.transport.place})") from None

    def _checked(self, task: ModelTask, request: Bundle, received: bytes, place: str) -> ModelAnswer:
        subject = f"the answer for `{task.name}` from {place}"
        try:
            answer = read_bundle(received, ANSWER)
            made_by = read_identity(answer.head.get("model"))
            check_answer(task, request, answer)
        except (BundleError, ConventionError, ModelError) as error:
            raise ModelError(f"{subject} {error}") from None
        if self.commercial_only:
            self._judge(made_by)
        confidence, warnings = answer.head.get("confidence"), answer.head.get("warnings", [])
        if confidence is not None and not (_is_number(confidence) and 0 <= confidence <= 1):
            raise ModelError(f"{subject} has a `confidence` of {plain(confidence, 40)}; it must be between 0 and 1")
        if not isinstance(warnings, list):
            raise ModelError(f"{subject} has `warnings` that are not a list of sentences")
        remarks = tuple(plain(one) for one in warnings[:20])
        return ModelAnswer(answer, made_by, None if confidence is None else float(confidence), remarks)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def notes(task: ModelTask) -> dict[str, dict[str, str]]:
    """Return the units and frames of a request's members, which are sent along with them."""
    stated = {m.name: {"unit": m.unit, "frame": m.frame} for m in task.inputs}
    return {name: {key: text for key, text in note.items() if text} for name, note in stated.items()}


def identities(description: Mapping[str, Any], task: str) -> tuple[ModelIdentity, ...]:
    """Return the models that a server's description lists for a task.

    Raises:
        ModelError: If the description does not list any.
    """
    listed = description.get("tasks")
    entry = listed.get(task) if isinstance(listed, Mapping) else None
    if not isinstance(entry, Mapping):
        known = plain(", ".join(sorted(map(str, listed)))) if isinstance(listed, Mapping) and listed else "no task"
        raise ModelError(f"the server does not solve `{task}`; it solves {known}")
    try:
        return (read_identity(entry.get("model")),)
    except ModelError as error:
        raise ModelError(f"the server's description of `{task}` {error}") from None
