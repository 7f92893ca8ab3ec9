"""Task cousins of the cluttered table, offline: how many of the paper's 13 are proposed, and none true or impossible.

``python -m tests.corpora.task_cousins`` prints every proposal and exits 1 where the bar is missed. What is done has to
last in PyBullet too, where that is installed. What is accepted is looked at once more: the goal is judged in the scene
as the document has it, and its witness, the state in which it is true, is let run in PyBullet.
"""

from __future__ import annotations

import sys
import tempfile
import time
from importlib.util import find_spec
from pathlib import Path

from simfoundry.cousins.layout.twin import bare
from simfoundry.cousins.tasks.candidate_poses import meaning, objects_of
from simfoundry.cousins.tasks.context import TaskContext
from simfoundry.cousins.tasks.enumeration import Proposal, checked, enumerate_tasks, scene_reference, write
from simfoundry.cousins.tasks.trial import LASTS
from simfoundry.cousins.tasks.witness import Witness, witness
from simfoundry.lint.lints import lint
from simfoundry.scene.state import SceneState
from simfoundry.spec.load import load
from simfoundry.spec.models.task import TaskSpec
from simfoundry.worlds import open_world
from tests.conftest import REPOSITORY

SCENE = REPOSITORY / "specs" / "scenes" / "cluttered.scene.yaml"
SECONDS = LASTS


def papers() -> dict[str, TaskSpec]:
    """The paper's tasks on the cluttered table."""
    specs = {
        file.name.partition(".")[0]: load(file).spec for file in sorted((SCENE.parents[1] / "tasks").glob("*.yaml"))
    }
    return {n: s for n, s in specs.items() if isinstance(s, TaskSpec) and Path(s.scene).name == SCENE.name}


def main() -> int:
    """Print the table."""
    started = time.perf_counter()
    setting = TaskContext.load(SCENE, engines=engines())
    with tempfile.TemporaryDirectory(dir=REPOSITORY / "specs", prefix=".proposed-") as folder:
        out = Path(folder)
        found = checked(enumerate_tasks(setting, scene=scene_reference(SCENE, out)), out)
        took = time.perf_counter() - started
        findings = [d for file in write(found, out) for d in (*load(file).findings, *lint(load(file)))]
    accepted = [p for p in found if p.accepted and p.task is not None]
    known = papers()
    place = {name: _proposed_as(spec, accepted, setting) for name, spec in known.items()}
    for proposal in found:
        reason = f"  [{proposal.reasons[0].text}]" if proposal.reasons else ""
        print(f"{'+' if proposal.accepted else '-'} {proposal.goal}{reason}")
    print(f"\n{len(found)} proposals in {took:.0f} s, {len(accepted)} accepted; {len(findings)} findings of `check`\n")
    for name, said in place.items():
        print(f"{name:<28} {said or 'MISSING'}")
    among = sum(map(bool, place.values()))
    true, impossible, elsewhere, looked = _again(setting, [p.task for p in accepted if p.task is not None])
    print(f"\n{among} of the paper's {len(known)} among them")
    print(f"already true: {len(true)} {true}; without a witness: {len(impossible)} {impossible}")
    print(
        f"witnesses whose goal does not hold after {SECONDS:g} s in PyBullet: {len(elsewhere)} of {looked} {elsewhere}"
    )
    return int(among < 13 or bool(true or impossible or findings or elsewhere))


def _proposed_as(spec: TaskSpec, accepted: list[Proposal], setting: TaskContext) -> str:
    """The proposal that means the same, or is done in a state in which a task of the paper is; empty without one.

    The paper says OnTop of what ends in a bowl, of which we propose the Inside only.
    """
    for k, proposal in enumerate(accepted, 1):
        assert proposal.task is not None
        goal = proposal.task.goal
        if meaning(goal) == meaning(spec.goal):
            return f"proposal {k}"
        if set(objects_of(goal)) == set(objects_of(spec.goal)):
            shown = witness(setting, goal)
            if isinstance(shown, Witness) and setting.twin.judge(spec.goal, shown.state).value:
                return f"proposal {k}, as {proposal.goal}"
    return ""


def engines() -> tuple[str, ...]:
    """MuJoCo, and PyBullet where it is installed."""
    return ("mujoco", "pybullet") if find_spec("pybullet") is not None else ("mujoco",)


def _again(setting: TaskContext, tasks: list[TaskSpec]) -> tuple[list[str], list[str], list[str], int]:
    """The tasks that are true already, have no witness, and whose witness is none in PyBullet; how many were run."""
    twin = setting.twin
    asleep = SceneState.initial(twin.scene)
    true, impossible, elsewhere, looked = [], [], [], 0
    for task in tasks:
        if twin.judge(task.goal, asleep).value or twin.judge(task.goal, twin.state).value:
            true.append(task.name)
        shown = witness(setting, task.goal)
        if not isinstance(shown, Witness) or not twin.judge(task.goal, shown.state).value:
            impossible.append(task.name)
        elif "pybullet" in setting.engines:
            looked += 1
            with open_world(bare(twin.scene), "pybullet") as other:  # it remembers contacts over a reset
                other.reset(shown.state)
                other.step(round(SECONDS / other.timestep))
                if not twin.judge(task.goal, other.state()).value:
                    elsewhere.append(task.name)
    return true, impossible, elsewhere, looked


if __name__ == "__main__":
    sys.exit(main())
