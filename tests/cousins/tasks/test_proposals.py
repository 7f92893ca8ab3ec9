"""Task cousins from a model: the paper's prompt, its answer read, and every bad proposal refused with its reason."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from simfoundry.cousins.tasks.context import TaskContext
from simfoundry.cousins.tasks.proposals import Told, Unread, goal_of, prompt, propose_tasks, read
from simfoundry.cousins.tasks.witness import ALLOWED
from simfoundry.spec.load import load
from simfoundry.spec.models.task import TaskSpec
from simfoundry.spec.yaml.write import to_yaml
from tests.conftest import REPOSITORY

RECORDED = Path(__file__).parent / "recorded" / "cluttered.txt"
SCENE = REPOSITORY / "specs" / "scenes" / "cluttered.scene.yaml"
PICTURE = b"\x89PNG\r\n\x1a\n"


@pytest.fixture(scope="module")
def setting() -> TaskContext:
    return TaskContext.load(SCENE)


class Recorded:
    """Answers as the recording does, and keeps what it was asked."""

    name = "recorded"

    def __init__(self) -> None:
        self.asked: list[str] = []

    def ask_text(self, prompt: str, pictures: Any = ()) -> str:
        assert list(pictures) == [PICTURE]
        self.asked.append(prompt)
        return RECORDED.read_text()

    def ask(self, prompt: str, pictures: Any, answer: Any) -> Any:
        tasks = [one.model_dump() for one in read(self.ask_text(prompt, pictures)) if isinstance(one, Told)]
        return answer.model_validate({"tasks": tasks})


EXPECTED = {
    "baseball_into_bowl": (),
    "tidy_red_marker": (),
    "pour_tea": ("unknown_name", "no object is called `teapot`"),
    "put_bowl_on_desk": ("already_true", "`bowl` touches `desk`"),
    "plate_into_bowl": ("too_wide", "`plate` is 22.7 cm wide at its narrowest"),
    "ball_in_bowl_again": ("duplicate", "`baseball_into_bowl`"),
    "cook_burger": ("bad_goal", "`Cooked` is not a predicate"),
    "mug_in_baseball": ("impossible", "`baseball` has no cavity"),
    "move_the_desk": ("fixed", "`desk` is fixed"),
    "two_markers": ("bad_goal", "must have exactly one member, not 2"),
    "sneaky": ("bad_goal", "is not of the form"),
    "part 12 of the response": ("unreadable", "not valid YAML"),
    "empty_handed": ("bad_goal", "has 0"),
    "eraser_away": (),
}


@pytest.mark.parametrize("form", ["paper", "typed"])
def test_good_proposals_are_accepted_and_bad_ones_say_why(setting: TaskContext, form: Any) -> None:
    vlm: Any = Recorded()
    found = propose_tasks(vlm, setting, PICTURE, 14, form, "cluttered.scene.yaml")
    expected = {n: e for n, e in EXPECTED.items() if form == "paper" or not n.startswith("part")}
    assert [p.name for p in found] == list(expected)
    for proposal, reason in zip(found, expected.values(), strict=True):
        said = [(r.code, r.text) for r in proposal.reasons]
        assert proposal.accepted is not bool(reason), (proposal.name, said)
        if reason:
            assert said[0][0] == reason[0]
            assert reason[1] in said[0][1]
    assert "exactly 14 distinct tasks" in vlm.asked[0]


def test_an_accepted_proposal_is_a_task_document(setting: TaskContext) -> None:
    vlm: Any = Recorded()
    found = propose_tasks(vlm, setting, PICTURE, 2, "paper", "cluttered.scene.yaml")
    made = found[0].task
    assert made is not None
    loaded = load(SCENE.parent / "baseball_into_bowl.task.yaml", text=to_yaml(made))
    assert isinstance(loaded.spec, TaskSpec)
    assert not loaded.findings
    assert list(made.subtasks) == ["touch_baseball", "pick_up_baseball", "baseball_in_bowl"]
    assert made.origin is not None
    assert "recorded" in (made.origin.note or "")


def test_what_is_excluded_is_refused(setting: TaskContext) -> None:
    vlm: Any = Recorded()
    found = propose_tasks(vlm, setting, PICTURE, 2, "paper", exclude=["baseball"], include=["bowl"])
    assert {p.name: p.reasons[0].code for p in found if p.reasons}["baseball_into_bowl"] == "excluded"
    assert "No task may involve: baseball." in vlm.asked[0]
    assert "Every task must involve one of: bowl." in vlm.asked[0]
    assert "- baseball -> " not in vlm.asked[0]


def test_the_prompt_is_the_paper_s_with_every_variable_filled_in(setting: TaskContext) -> None:
    text = prompt(setting, 7, "paper")
    assert text.startswith("You are a professional robotic expert in sim-to-real, robot learning, and VLAs.\n")
    assert "propose exactly 7 distinct tasks that a franka robotiq arm can perform" in text
    assert "opens at most 85 mm" in text
    assert "- red_bottle -> bottle, red_bottle" in text
    assert all(state in text for state in ALLOWED if state != "At")
    assert "{" not in text.replace("e.g.", "")


def test_text_around_and_fences_are_passed_over() -> None:
    assert read("Sure!\n\n```yaml\ntask_name: a\ngoal_predicates_all: []\n```\nDone.") == [
        Told(task_name="a", goal_predicates_all=[])
    ]


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("task_name: a\ngoal_predicates_all: [{state: Open}]", "group"),
        ("task_name: 5\ngoal_predicates_all: []", "task_name"),
        ("goal_predicates_all: []", "task_name"),
        ("task_name: a\n  b: {", "not valid YAML"),
        ("- task_name: a", "must be a mapping"),
    ],
)
def test_what_cannot_be_read_says_why(text: str, why: str) -> None:
    (found,) = read(text)
    assert isinstance(found, Unread)
    assert why in found.why


def test_values_and_any_become_a_condition() -> None:
    told = Told.model_validate(
        {
            "task_name": "t",
            "semantic_group_mapping": {"c": ["cup"]},
            "goal_predicates_all": [{"state": "Open", "group": "box.lid", "value": False}],
            "goal_predicates_any": [{"state": "Inside", "group": "c", "other_group": "box"}],
        }
    )
    assert goal_of(told) == ({"all": ({"not": "Open(box.lid)"}, {"any": ("Inside(cup, box)",)})}, "")
