"""Tasks for a reconstructed scene, from its affordances or from a vision-language model."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from simfoundry.capture.tasks import SceneTasks, TaskRequest
from simfoundry.cousins.tasks.context import TaskContext
from simfoundry.cousins.tasks.enumeration import Proposal, checked, enumerate_tasks, file_of
from simfoundry.cousins.tasks.proposals import propose_tasks
from simfoundry.models.vlm import VlmError
from simfoundry.spec.yaml.write import to_yaml

if TYPE_CHECKING:
    from simfoundry.assets.cache import Cache
    from simfoundry.models.vlm import Vlm


def task_request(count: int, cache: Cache | None = None, vlm: Vlm | None = None) -> TaskRequest:
    """Return a request for ``count`` tasks, which ``vlm`` proposes if there is one.

    Tasks that it does not propose, or that are not feasible, are replaced by those from the affordances of the objects.
    """
    return TaskRequest(count, partial(_find, cache, vlm))


def _find(cache: Cache | None, vlm: Vlm | None, scene: Path, count: int, picture: bytes) -> SceneTasks:
    context, folder = TaskContext.load(scene, cache), scene.parent
    problems: tuple[str, ...] = ()
    found: list[Proposal] = []
    if vlm is not None:
        try:
            found = _accepted(propose_tasks(vlm, context, picture, count, scene=scene.name), folder)[:count]
        except VlmError as error:
            problems = (f"the model for tasks failed: {error}",)
    if len(found) < count:
        goals = {proposal.goal for proposal in found}
        names = {proposal.name for proposal in found}
        # Some of those that are enumerated repeat proposals of the model.
        others = _accepted(enumerate_tasks(context, count + len(found), scene=scene.name), folder)
        found += [p for p in others if p.goal not in goals and p.name not in names][: count - len(found)]
    documents = {file_of(p, folder).name: to_yaml(p.task).encode() for p in found if p.task is not None}
    return SceneTasks(documents, {p.name: p.task.instruction for p in found if p.task is not None}, problems)


def _accepted(proposals: Sequence[Proposal], folder: Path) -> list[Proposal]:
    """Return the proposals that are feasible and pass ``simfoundry check`` as documents in a folder."""
    return [proposal for proposal in checked(proposals, folder) if proposal.accepted]
