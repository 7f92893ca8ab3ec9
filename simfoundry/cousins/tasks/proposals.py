"""Task cousins that a vision-language model proposes in response to the paper's prompt.

They are verified in the same way as all other tasks.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import TYPE_CHECKING, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from simfoundry.cousins.recipe.candidate import ImpossibleError, Reason
from simfoundry.cousins.tasks.acceptance import impossible, misnamed, unchanged, unreached
from simfoundry.cousins.tasks.candidate_poses import conjuncts, goal_words, objects_of
from simfoundry.cousins.tasks.context import TaskContext
from simfoundry.cousins.tasks.enumeration import (
    Proposal,
    Proposals,
    enumerate_tasks,
    free_name,
    instruction_of,
    subtasks,
    task,
)
from simfoundry.cousins.tasks.ideas import Idea, step_of
from simfoundry.cousins.tasks.witness import ALLOWED, ON
from simfoundry.errors import SimfoundryError
from simfoundry.robots.reach import Hand, hands_of
from simfoundry.runtime.extras import install_line
from simfoundry.scene.frames import FrameTree
from simfoundry.spec.models.cousins import TaskAxis
from simfoundry.spec.models.predicate import texts
from simfoundry.spec.models.task import TaskSpec
from simfoundry.spec.yaml.nodes import YamlError
from simfoundry.spec.yaml.text import parse

if TYPE_CHECKING:
    from simfoundry.cousins.layout.twin import Twin
    from simfoundry.models.vlm import Vlm
    from simfoundry.scene.model import SceneObject
    from simfoundry.scene.state import SceneState
    from simfoundry.spec.models.scene import SceneSpec

# Format of the model's response: typed, or the text format that the paper's prompt requests.
Form = Literal["typed", "paper"]


def propose_tasks(
    vlm: Vlm,
    setting: TaskContext,
    picture: bytes,
    count: int = 10,
    form: Form = "typed",
    scene: str = "",
    include: Sequence[str] = (),
    exclude: Sequence[str] = (),
) -> list[Proposal]:
    """Ask a model to propose tasks in a scene, and verify them.

    Args:
        vlm: The vision-language model.
        setting: Context of the tasks.
        picture: Image of the scene as PNG or JPEG.
        count: Number of tasks to request.
        form: Format of the response.
        scene: Path to the scene, as written in task documents.
        include: Objects of which each task should involve at least one. If it is empty, there is no such requirement.
        exclude: Objects that tasks must not involve.

    Raises:
        VlmError: If the model does not respond.
    """
    asked = prompt(setting, count, form, include, exclude)
    told: Sequence[Told | Unread]
    told = vlm.ask(asked, [picture], ProposalsAnswer).tasks if form == "typed" else read(vlm.ask_text(asked, [picture]))
    return judged(told, setting, f"proposed by {vlm.name}", scene, exclude)


def prompt(
    setting: TaskContext, count: int, form: Form = "paper", include: Sequence[str] = (), exclude: Sequence[str] = ()
) -> str:
    """Render the paper's prompt for a scene.

    The typed form omits the description of the text format.
    """
    try:
        from jinja2 import Environment, StrictUndefined
    except ImportError:
        raise SimfoundryError(f"prompts require jinja2; install it with `{install_line('vlm')}`") from None
    text = files(__package__).joinpath("templates", f"{form}.txt.j2").read_text(encoding="utf-8")
    template = Environment(undefined=StrictUndefined, autoescape=False).from_string(text)
    objects = [o for o in setting.twin.scene.objects if o.name not in exclude and o.name not in setting.twin.absent]
    return template.render(
        num_tasks=count,
        robot_type=_robots(setting),
        robot_constraint=_robot_constraint(setting),
        object_constraints=_object_constraints(include, exclude),
        object_list="\n".join(f"- {o.name} -> {o.category or o.name}, {o.name}{_parts(setting, o)}" for o in objects),
        states=", ".join(state for state in ALLOWED if state != "At"),
    )


def _robots(setting: TaskContext) -> str:
    kinds = dict.fromkeys(hand.kind or "robot" for hand in setting.hands)
    number = "bimanual " if len(setting.hands) > 1 else ""
    return number + " and ".join(kind.replace("_", " ") for kind in kinds) if kinds else "robot"


def _robot_constraint(setting: TaskContext) -> str:
    arms = {0: "There is no robot yet.", 1: "There is a single arm."}
    lines = [f"- {arms.get(len(setting.hands), f'There are {len(setting.hands)} arms.')}"]
    for hand in setting.hands:
        opens = f" opens at most {1000 * hand.opening:.0f} mm," if hand.opening else ""
        reach = f" reaches {hand.reach:g} m" if hand.reach else ""
        lines.append(f"- The gripper of `{hand.name}`{opens}{reach} and lifts {hand.payload:g} kg.")
    return "\n".join(lines)


def _object_constraints(include: Sequence[str], exclude: Sequence[str]) -> str:
    lines = [f"- Every task must involve one of: {', '.join(include)}."] if include else []
    lines += [f"- No task may involve: {', '.join(exclude)}."] if exclude else []
    return "\n".join(lines) or "- None."


def _parts(setting: TaskContext, item: SceneObject) -> str:
    parts = ", ".join(f"{item.name}.{joint.child}" for joint in setting.joints(item.name))
    return f" (parts: {parts})" if parts else ""


def judged(
    told: Sequence[Told | Unread], setting: TaskContext, source: str, scene: str = "", exclude: Sequence[str] = ()
) -> list[Proposal]:
    """Verify tasks proposed by a model.

    Args:
        told: The tasks in the model's response.
        setting: Context of the tasks.
        source: Origin of the tasks, for the documents.
        scene: Path to the scene, as written in task documents.
        exclude: Objects that tasks must not involve.

    Returns:
        One proposal per task. Accepted proposals contain a document, and rejected proposals contain reasons.
    """
    proposed = Proposals(setting)
    for one in told:
        if isinstance(one, Unread):
            proposed.found.append(Proposal(one.name, "", None, (Reason("unreadable", one.why),)))
        elif (refused := _propose(one, proposed, source, scene, exclude)) is not None:
            proposed.found.append(refused)
    return proposed.found


def _propose(told: Told, proposed: Proposals, source: str, scene: str, exclude: Sequence[str]) -> Proposal | None:
    """Add a task from a model's response to the proposals.

    Returns:
        None, or a rejected proposal if the task is so flawed that no document can be written.
    """
    setting = proposed.setting
    name = free_name(told.task_name, {accepted.name for accepted in proposed.accepted})
    goal, wrong = goal_of(told)
    said = goal_words(goal)
    if wrong:
        return Proposal(name, said, None, (Reason("bad_goal", wrong),))
    if lacks := misnamed(goal, setting):
        return Proposal(name, said, None, lacks)
    barred = sorted({a for text, _ in texts(goal) for a in exclude if a in text.replace(",", " ").replace("(", " ")})
    if barred:
        return Proposal(name, said, None, (Reason("excluded", f"it involves `{barred[0]}`, which is excluded"),))
    goal = _released(goal)
    steps = [step_of(call) for call in conjuncts(goal) if call.predicate != "Released"]
    idea = Idea(name, (goal,), tuple(steps))
    plain = instruction_of(idea) if steps else f"{told.task_name.replace('_', ' ').strip().capitalize()}."
    words = told.instruction.strip() or plain
    note = f"task cousin of `{setting.twin.scene.name}`, {source}"
    made = task(name, setting, scene or "scene.yaml", words, goal, subtasks(idea, setting), note)
    proposed.add(name, said, made)
    return None


def _released(goal: Any) -> Any:
    """Return the goal with a `Released` predicate added for each placed object."""
    placed = dict.fromkeys(c.args[0] for c in conjuncts(goal) if c.predicate in ON and c.predicate != "Touching")
    there = {str(call) for call in conjuncts(goal)}
    more = tuple(text for name in placed if "." not in name and (text := f"Released({name})") not in there)
    every = (*goal["all"], *more)
    return every[0] if len(every) == 1 else {"all": every}


# Maximum number of tasks to read from a response. Far fewer are requested.
MOST_TASKS = 200
# Maximum number of characters of a response to parse; the rest is ignored.
MOST_TEXT = 100_000

# Separators between tasks, such as `--- Task 2`, and the code fences that models tend to put around YAML.
_MARK = re.compile(r"^\s*-{3,}[^\n]*$|^\s*```[^\n]*$", re.MULTILINE)


class AskedTask(BaseModel):
    """A predicate in a goal: the state of one group, or a relation between two groups."""

    model_config = ConfigDict(extra="ignore")

    state: str = Field(max_length=40, description="One of the allowed states.")
    group: str = Field(max_length=130, description="The object, or `object.part`.")
    other_group: str | None = Field(None, max_length=130, description="The other object, for binary states.")
    value: bool = Field(True, description="False if the predicate must not hold.")
    state_kwargs: dict[str, Any] | None = Field(None, description="Not used; null.")


class Told(BaseModel):
    """A proposed task."""

    model_config = ConfigDict(extra="ignore")

    task_name: str = Field(min_length=1, max_length=100, description="Short snake_case name.")
    instruction: str = Field("", max_length=400, description="The robot's instruction in plain words.")
    goal_predicates_all: list[AskedTask] = Field([], max_length=16, description="All must be true for success.")
    goal_predicates_any: list[AskedTask] | None = Field(None, max_length=16, description="One must be true, or null.")
    semantic_group_mapping: dict[str, list[str]] = Field(
        {}, max_length=32, description="Required only if group names differ from object names."
    )


class ProposalsAnswer(BaseModel):
    """The proposed tasks."""

    tasks: list[Told] = Field(max_length=MOST_TASKS)


class Unread(BaseModel):
    """A part of a response that could not be parsed, with the reason."""

    name: str
    why: str


def read(text: str) -> list[Told | Unread]:
    """Parse the tasks in a response in the paper's format.

    In this format, YAML blocks are separated by lines such as `--- Task n`.
    """
    found: list[Told | Unread] = []
    blocks = [block for block in _MARK.split(text[:MOST_TEXT]) if block.strip()]
    for block in blocks[:MOST_TASKS]:
        label = f"part {len(found) + 1} of the response"
        try:
            data = parse(block, label).data
        except YamlError as error:
            found.append(Unread(name=label, why=f"it is not valid YAML: {error}"))
            continue
        if not isinstance(data, dict):
            if "task_name" in block:
                found.append(Unread(name=label, why="it must be a mapping with the key `task_name`"))
            continue  # text between tasks
        try:
            found.append(Told.model_validate(data))
        except ValidationError as error:
            first = error.errors()[0]
            at = ".".join(str(part) for part in first["loc"])
            name = data.get("task_name")
            found.append(Unread(name=name[:64] if isinstance(name, str) else label, why=f"`{at}`: {first['msg']}"))
    return found


def goal_of(told: Told) -> tuple[Any, str]:
    """Convert a proposed goal to a condition.

    Returns:
        The condition and an error message, which is empty if the goal is valid.
    """
    groups, either = told.semantic_group_mapping, told.goal_predicates_any or []
    names = {group: members[0] for group, members in groups.items() if len(members) == 1}
    wrong = [f"group `{g[:40]}` must have exactly one member, not {len(m)}" for g, m in groups.items() if len(m) != 1]
    if any(asked.state_kwargs for asked in (*told.goal_predicates_all, *either)):
        wrong.append("`state_kwargs` must be null")
    terms = [_term(asked, names) for asked in told.goal_predicates_all]
    terms += [{"any": tuple(_term(asked, names) for asked in either)}] if either else []
    return {"all": tuple(terms)}, next(iter(wrong), "")


def _term(asked: AskedTask, names: dict[str, str]) -> Any:
    groups = [asked.group, *([asked.other_group] if asked.other_group else [])]
    text = f"{asked.state}({', '.join(names.get(group, group) for group in groups)})"
    return text if asked.value else {"not": text}


@dataclass(frozen=True)
class TaskCousin:
    """A task that was verified in the twin.

    Attributes:
        spec: The task document.
        goal: The goal as text.
        hands: Hands that can act in the task.
        engines: Physics engines in which the goal state must remain stable.
    """

    spec: TaskSpec
    goal: str
    hands: tuple[Hand, ...] = ()
    engines: tuple[str, ...] = ("mujoco",)

    def reasons(self, twin: Twin, state: SceneState, others: Collection[str] = ()) -> tuple[Reason, ...]:
        """Return the reasons why the task cannot be used in a settled scene. The result is empty if it can be used.

        A task cannot be used if its goal already holds or an object is out of reach. The goal is known to be feasible
        in the twin, and feasibility does not depend on the layout. It is verified again only if an object in the goal
        was replaced.

        Args:
            twin: The twin.
            state: Settled state of the scene.
            others: Names of the objects that were replaced.
        """
        setting = TaskContext(twin.at(state), self.hands, engines=self.engines)
        found = unchanged(self.spec.goal, setting) or unreached(self.spec.goal, setting)
        return found or (impossible(self.spec.goal, setting) if set(objects_of(self.spec.goal)) & set(others) else ())


def task_cousins(
    twin: Twin,
    scene: SceneSpec,
    axis: TaskAxis,
    seed: int = 0,
    reference: str = "",
    vlm: Vlm | None = None,
    picture: bytes = b"",
) -> tuple[tuple[TaskCousin, ...], tuple[Proposal, ...]]:
    """Return the feasible tasks for the task axis of a recipe, and all proposals that were examined.

    Args:
        twin: The twin.
        scene: Document of the twin's scene.
        axis: The task axis.
        seed: Seed for the random number generator.
        reference: Path to the scene, as written in task documents.
        vlm: Model to query if the axis requests proposals from a model.
        picture: Image of the scene for the model.

    Raises:
        ImpossibleError: If no task is feasible, or if the axis requires a model but ``vlm`` is None.
    """
    setting = TaskContext(twin, hands_of(scene.robots, FrameTree(scene)), engines=axis.engines)
    if axis.proposals == "model":
        if vlm is None:
            why = "`proposals: model` requires a model; specify one, or use `affordances`"
            raise ImpossibleError((Reason("no_model", why),))
        rest = sorted({o.name for o in twin.scene.objects} - set(axis.objects)) if axis.objects else []
        found = propose_tasks(vlm, setting, picture, axis.count, "typed", reference, axis.objects, rest)
    else:
        found = enumerate_tasks(setting, axis.count, seed, reference, axis.objects)
    tasks = [(p.task, p.goal) for p in found if p.accepted and p.task is not None]
    good = tuple(TaskCousin(spec, goal, setting.hands, axis.engines) for spec, goal in tasks)
    if not good:
        said = "; ".join(f"{p.name}: {p.reasons[0].text}" for p in found[:3] if p.reasons)
        text = f"none of the {len(found)} proposed tasks is possible" + (f": {said}" if said else "")
        raise ImpossibleError((Reason("no_task", text),))
    return good, tuple(found)
