"""Task cousins from a vision-language model, asked with the paper's prompt; each is proved as any other."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.resources import files
from typing import TYPE_CHECKING, Any, Literal

from simfoundry.cousins.reasons import Reason
from simfoundry.cousins.tasks.accept import misnamed
from simfoundry.cousins.tasks.answer import Answer, Told, Unread, goal_of, read
from simfoundry.cousins.tasks.document import free_name, instruction_of, subtasks, task
from simfoundry.cousins.tasks.enumerate import Proposal, Proposals
from simfoundry.cousins.tasks.ideas import Idea, step_of
from simfoundry.cousins.tasks.meaning import conjuncts, goal_words
from simfoundry.cousins.tasks.setting import Setting
from simfoundry.cousins.tasks.witness import ALLOWED, ON
from simfoundry.errors import SimfoundryError
from simfoundry.runtime.extras import install_line
from simfoundry.spec.models.expressions import texts

if TYPE_CHECKING:
    from simfoundry.models.vlm import Vlm

Form = Literal["typed", "paper"]
"""How the model is to answer: in a type, or in the text that the paper's prompt asks for."""


def propose_tasks(
    vlm: Vlm,
    setting: Setting,
    picture: bytes,
    count: int = 10,
    form: Form = "typed",
    scene: str = "",
    include: Sequence[str] = (),
    exclude: Sequence[str] = (),
) -> list[Proposal]:
    """What a model proposes for a scene that it sees in a ``picture`` (PNG or JPEG), each with why it is not accepted.

    ``include`` are objects that each task should be about, ``exclude`` those that none may. Raises ``VlmError`` where
    the model gives no answer.
    """
    asked = prompt(setting, count, form, include, exclude)
    told: Sequence[Told | Unread]
    told = vlm.ask(asked, [picture], Answer).tasks if form == "typed" else read(vlm.ask_text(asked, [picture]))
    return judged(told, setting, f"proposed by {vlm.name}", scene, exclude)


def prompt(
    setting: Setting, count: int, form: Form = "paper", include: Sequence[str] = (), exclude: Sequence[str] = ()
) -> str:
    """The paper's prompt for a scene; in the typed form without the part that describes the text of the answer."""
    try:
        from jinja2 import Environment, StrictUndefined
    except ImportError:
        raise SimfoundryError(f"prompts need jinja2; install with `{install_line('vlm')}`") from None
    text = files(__package__).joinpath("templates", f"{form}.txt.j2").read_text(encoding="utf-8")
    template = Environment(undefined=StrictUndefined, autoescape=False).from_string(text)
    objects = [o for o in setting.twin.scene.objects if o.name not in exclude and o.name not in setting.twin.absent]
    return template.render(
        num_tasks=count,
        robot_type=_robots(setting),
        robot_constraint=_robot_constraint(setting),
        object_constraints=_object_constraints(include, exclude),
        object_list="\n".join(
            f"- {o.name} -> {o.category or o.name}, {o.name}{_parts(setting, o.name)}" for o in objects
        ),
        states=", ".join(state for state in ALLOWED if state != "At"),
    )


def _robots(setting: Setting) -> str:
    kinds = dict.fromkeys(hand.kind or "robot" for hand in setting.hands)
    number = "bimanual " if len(setting.hands) > 1 else ""
    return number + " and ".join(kind.replace("_", " ") for kind in kinds) if kinds else "robot"


def _robot_constraint(setting: Setting) -> str:
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


def _parts(setting: Setting, name: str) -> str:
    parts = [joint.child for joint in setting.joints(name)]
    return f" (parts: {', '.join(f'{name}.{part}' for part in parts)})" if parts else ""


def judged(
    told: Sequence[Told | Unread],
    setting: Setting,
    source: str,
    scene: str = "",
    exclude: Sequence[str] = (),
) -> list[Proposal]:
    """Proposed tasks as documents, those that are accepted; of the others why not."""
    proposed = Proposals(setting)
    for one in told:
        if isinstance(one, Unread):
            proposed.found.append(Proposal(one.name, "", None, (Reason("unreadable", one.why),)))
        elif (refused := _propose(one, proposed, source, scene, exclude)) is not None:
            proposed.found.append(refused)
    return proposed.found


def _propose(told: Told, proposed: Proposals, source: str, scene: str, exclude: Sequence[str]) -> Proposal | None:
    """Propose what a model said; why not, where no document can be made of it."""
    setting = proposed.setting
    name = free_name(told.task_name, proposed.names)
    goal, wrong = goal_of(told)
    said = goal_words(goal)
    if wrong:
        return Proposal(name, said, None, (Reason("bad_goal", wrong),))
    if lacks := misnamed(goal, setting):
        return Proposal(name, said, None, lacks)
    barred = sorted({a for text, _ in texts(goal) for a in exclude if a in text.replace(",", " ").replace("(", " ")})
    if barred:
        return Proposal(name, said, None, (Reason("excluded", f"it is about `{barred[0]}`, which was excluded"),))
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
    """The goal, and that nothing holds what it wants put somewhere; as it is where it names one predicate only."""
    placed = dict.fromkeys(c.args[0] for c in conjuncts(goal) if c.predicate in ON and c.predicate != "Touching")
    there = {str(call) for call in conjuncts(goal)}
    more = tuple(text for name in placed if "." not in name and (text := f"Released({name})") not in there)
    every = (*goal["all"], *more)
    return every[0] if len(every) == 1 else {"all": every}
