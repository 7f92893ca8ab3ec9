"""The models that are configured: what answers, its version, its licence, and whether it may be used commercially."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from typing import Any, Literal

from simfoundry.models.client import ModelClient, identities
from simfoundry.models.contract import ModelError
from simfoundry.models.open import OFFLINE
from simfoundry.models.provenance import ModelIdentity, judged, require_commercial
from simfoundry.models.setup import ModelSetup
from simfoundry.models.tasks.registry import TASKS
from simfoundry.runtime.extras import MissingExtraError

# What is known of a task's model: that it answers, that it was not asked, that it fails or may not be used, that there
# is only the offline method, or nothing.
Status = Literal["answers", "configured", "fails", "refused", "offline", "none"]


@dataclass(frozen=True)
class TaskModel:
    """The model behind a task.

    Attributes:
        task: Name of the task.
        role: Name of the model in the paper.
        summary: What the task is.
        status: What is known of the model.
        place: Address, command or folder; empty for offline methods.
        configured_in: File or environment variable.
        model: The model as it describes itself, or None if it was not asked.
        commercial: Permission for commercial use, and its reason, or empty strings.
        problem: Reason for a failure or a refusal.
    """

    task: str
    role: str
    summary: str
    status: Status
    place: str = ""
    configured_in: str = ""
    model: ModelIdentity | None = None
    commercial: tuple[str, str] = ("", "")
    problem: str = ""

    def to_json(self) -> dict[str, Any]:
        """Return the row as plain data."""
        permission, reason = self.commercial
        plain = {**asdict(self), "model": None if self.model is None else self.model.to_json()}
        return {**plain, "commercial": permission, "reason": reason}


def inventory(setup: ModelSetup, check: bool = False) -> tuple[TaskModel, ...]:
    """Return one row for each task.

    Args:
        setup: The configured models.
        check: Whether to ask each server, command and recording for its model.
    """
    clients: dict[str, ModelClient] = {}
    problems: dict[str, str] = {}
    for task in TASKS:
        source = setup.source(task)
        if source is not None and not source.offline and source.vlm is None:
            try:
                clients[task] = setup.client(task)
            except (ModelError, MissingExtraError) as error:
                problems[task] = str(error)
    asked = {task: client for task, client in clients.items() if check or setup.sources[task][0].weights is not None}
    described = _descriptions(asked)
    return tuple(_row(setup, task, clients, problems, described) for task in TASKS)


def _descriptions(clients: Mapping[str, ModelClient]) -> dict[str, Mapping[str, Any] | ModelError]:
    """Ask each transport once, all of them at the same time."""
    transports = {client.transport.place: client.transport for client in clients.values()}

    def ask(place: str) -> Mapping[str, Any] | ModelError:
        try:
            return transports[place].describe()
        except ModelError as error:
            return error

    if not transports:
        return {}
    with ThreadPoolExecutor(max_workers=len(transports)) as pool:
        answers = dict(zip(transports, pool.map(ask, transports), strict=True))
    return {task: answers[client.transport.place] for task, client in clients.items()}


def _row(
    setup: ModelSetup,
    name: str,
    clients: Mapping[str, ModelClient],
    problems: Mapping[str, str],
    described: Mapping[str, Mapping[str, Any] | ModelError],
) -> TaskModel:
    task = TASKS[name]
    about = (name, task.role, task.summary)
    where = setup.sources[name][1] if name in setup.sources else ""
    if name in problems:
        return TaskModel(*about, "fails", configured_in=where, problem=problems[name])
    source = setup.source(name)
    if source is not None and source.vlm is not None:
        return TaskModel(*about, "configured", source.vlm, where)
    if name not in clients:
        if name not in OFFLINE:
            return TaskModel(*about, "none", configured_in=where)
        return TaskModel(*about, "offline", OFFLINE[name][1], where, commercial=("allowed", "it is part of SimFoundry"))
    place = clients[name].transport.place
    answer = described.get(name)
    if answer is None:
        return TaskModel(*about, "configured", place, where)
    try:
        if isinstance(answer, ModelError):
            raise answer
        (identity,) = identities(answer, name)
    except ModelError as error:
        return TaskModel(*about, "fails", place, where, problem=str(error))
    try:
        if setup.commercial_only:
            require_commercial(identity, setup.accepted)
    except ModelError as error:
        return TaskModel(*about, "refused", place, where, identity, judged(identity), str(error))
    return TaskModel(*about, "answers", place, where, identity, judged(identity))


def lines(rows: Sequence[TaskModel]) -> list[str]:
    """Return the inventory as a table for people."""
    out = []
    for row in rows:
        if row.model is not None:
            what = f"{row.model.name} {row.model.version}, {row.model.licence}, commercial use: {row.commercial[0]}"
        else:
            what = row.place if row.status == "offline" else ""
        where = f" ({row.place})" if row.place and row.status != "offline" else ""
        out.append(f"{row.task:<15} {row.status:<10} {what}{where}".rstrip())
        if row.problem:
            out.append(f"{'':<15} -> {row.problem}")
    return out
