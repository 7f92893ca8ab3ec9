"""Task cousins as an axis of a recipe: tasks found once in the twin, each asked again in every layout."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from simfoundry.cousins.reasons import ImpossibleError, Reason
from simfoundry.cousins.tasks.accept import impossible, unchanged, unreached
from simfoundry.cousins.tasks.enumerate import Proposal, enumerate_tasks
from simfoundry.cousins.tasks.meaning import objects_of
from simfoundry.cousins.tasks.setting import Hand, Setting, hands_of
from simfoundry.spec.models.cousins import TaskAxis
from simfoundry.spec.models.task import TaskSpec

if TYPE_CHECKING:
    from simfoundry.cousins.twin import Twin
    from simfoundry.models.vlm import Vlm
    from simfoundry.scene.state import SceneState
    from simfoundry.spec.models.scene import SceneSpec


@dataclass(frozen=True)
class TaskCousin:
    """A task that was proved in the twin; ``goal`` is what it asks for, as text, and ``hands`` act in it.

    What is done lasts in all ``engines``.
    """

    spec: TaskSpec
    goal: str
    hands: tuple[Hand, ...] = ()
    engines: tuple[str, ...] = ("mujoco",)

    def reasons(self, twin: Twin, state: SceneState, others: Collection[str] = ()) -> tuple[Reason, ...]:
        """Why it is no task in a scene as it stands: done already, or its things out of reach; empty where it is one.

        That its things fit each other was proved in the twin, and no layout changes it; it is proved anew where one of
        them is among the ``others``, which are not the twin's.
        """
        setting = setting_in(twin, state, self.hands, self.engines)
        found = unchanged(self.spec.goal, setting) or unreached(self.spec.goal, setting)
        return found or (impossible(self.spec.goal, setting) if set(objects_of(self.spec.goal)) & set(others) else ())


def setting_in(twin: Twin, state: SceneState, hands: tuple[Hand, ...], engines: tuple[str, ...]) -> Setting:
    """The setting of a twin in another state."""
    here = replace(twin, state=state, kept={k: v for k, v in twin.kept.items() if k == "reach"})
    here.__dict__.update(judge=twin.judge, world=twin.world)  # prepared for the same scene
    return Setting(here, hands, engines=engines)


def task_cousins(
    twin: Twin,
    scene: SceneSpec,
    axis: TaskAxis,
    seed: int = 0,
    reference: str = "",
    vlm: Vlm | None = None,
    picture: bytes = b"",
) -> tuple[tuple[TaskCousin, ...], tuple[Proposal, ...]]:
    """The tasks of a recipe's axis in a twin, and all that was proposed on the way.

    ``scene`` is the twin's document and ``reference`` its file as the tasks' documents name it. A ``vlm`` that sees the
    ``picture`` is asked where the axis says so. Raises :class:`ImpossibleError` where nothing can be done.
    """
    setting = Setting(twin, hands_of(scene), engines=axis.engines)
    if axis.proposals == "model":
        if vlm is None:
            why = "`proposals: model` needs a model: name one, or take `affordances`"
            raise ImpossibleError((Reason("no_model", why),))
        from simfoundry.cousins.tasks.propose import propose_tasks

        every = sorted({o.name for o in twin.scene.objects} - set(axis.objects)) if axis.objects else []
        found: Sequence[Proposal] = propose_tasks(
            vlm, setting, picture, axis.count, scene=reference, include=axis.objects, exclude=every
        )
    else:
        found = enumerate_tasks(setting, axis.count, seed, reference, axis.objects)
    good = tuple(
        TaskCousin(p.task, p.goal, setting.hands, axis.engines) for p in found if p.accepted and p.task is not None
    )
    if not good:
        said = "; ".join(f"{p.name}: {p.reasons[0].text}" for p in found[:3] if p.reasons)
        text = f"none of {len(found)} proposed tasks is possible" + (f": {said}" if said else "")
        raise ImpossibleError((Reason("no_task", text),))
    return good, tuple(found)
