"""Augmentation: demonstrations from segments of others, as ordinary as those that are recorded."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

import simfoundry as sf
from simfoundry.api.augmentation import UNSEEN, augment_plan
from simfoundry.augment.library import open_library
from simfoundry.augment.report import augment_report
from simfoundry.data.record import record
from simfoundry.errors import SimfoundryError
from simfoundry.evaluate.statistics.metrics import Rate
from tests.cli.command import Done, run
from tests.corpora.record import SCENE, TASK
from tests.data.test_record import bytes_of


def test_segments_go_from_free_space_to_free_space(cell: Path) -> None:
    found = sf.demonstrations(cell / "demos")
    segments = open_library(cell / "demos").segments
    assert [(one.demonstration, one.subgoal.name) for one in segments] == [
        (k, name) for k in (0, 1) for name in ("Grasped(cube)", "OnTop(cube, crate)")
    ]
    for demo, grasp, place in zip(found, segments[::2], segments[1::2], strict=True):
        assert (grasp.subgoal.reference, place.subgoal.reference, place.subgoal.held) == ("cube", "crate", "cube")
        assert 0 == grasp.begin < grasp.first < grasp.moment < grasp.last == place.begin < place.first < place.moment
        assert place.last == demo.steps and not grasp.is_joined and not place.is_joined
        (motion,) = grasp.motions.values()
        assert len(motion.targets) == len(motion.grippers) == grasp.last
        hands, cube = demo.states["arm/hand"], demo.states["objects"][:, demo.about["objects"].index("cube"), :3]
        apart = np.linalg.norm(hands[:, :3] - cube, axis=1)
        assert apart[grasp.first] > apart[grasp.moment] + 0.02  # the hand comes from 3 cm away
        assert cube[grasp.last, 2] > cube[0, 2] + 0.02  # and goes up by as much
        assert demo.states["arm/gripper"][place.last, 0] < demo.states["arm/gripper"][place.first, 0]


OPTIONS = ("augment", "demos", "-o", "more", "--select", "random", "--noise", "0.003")


@pytest.fixture(scope="module")
def more(cell: Path) -> Done:
    """What the command that generated two demonstrations in ``more`` said."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(cell)
        done = run(*OPTIONS, "-n", "2", "--json")
    assert done.code == 0, done.err
    return done


@pytest.mark.usefixtures("more", "here")
def test_generated_demonstrations_are_ordinary_and_new() -> None:
    found, sources = sf.demonstrations("more"), sf.demonstrations("demos")
    assert len(found) == 2 and found.about["policy"] == "augment" and found.about["source"] == "../demos"
    assert found.about["seed"] == sources.about["seed"] + UNSEEN
    assert not {demo.start.digest for demo in found} & {demo.start.digest for demo in sources}
    with found.open() as world:
        for demo in found:
            names = [one["subgoal"] for one in demo.origin["segments"]]
            assert names == ["Grasped(cube)", "OnTop(cube, crate)"]
            assert {one["demonstration"] for one in demo.origin["segments"]} <= {0, 1}
            assert demo.action_space == sources[0].action_space and demo.action_hz == sources[0].action_hz
            last = list(found.replay(demo, world))[-1]
            np.testing.assert_array_equal([*last.poses["cube"].p], demo.states["objects"][-1][1][:3])


def test_the_command_reports_rates_and_continues(more: Done, here: Path) -> None:
    rates = more.json["rates"]
    assert more.json["demonstrations"] == 2 and rates["success"]["successes"] == 2
    (task,) = rates["tasks"]
    assert task["document"] == "../stack.task.yaml" and task["rate"] == rates["success"]["rate"]
    assert len(task["interval"]) == 2 and {one["subgoal"] for one in rates["subgoals"]} >= {"Grasped(cube)"}
    assert {one["demonstration"] for one in rates["sources"]} <= {0, 1}
    assert all(one["successes"] <= one["attempts"] for one in rates["sources"])
    before = bytes_of(here / "more")
    again = run(*OPTIONS, "-n", "2")
    assert again.code == 0 and bytes_of(here / "more") == before
    assert "more: 2 demonstrations in" in again.out and "OnTop(cube, crate)  2/2" in again.out
    other = run("augment", "demos", "-o", "more", "-n", "3")
    assert other.code == 2 and "a different policy" in other.err  # without noise


@pytest.mark.slow  # 15 s: it generates several times
def test_the_bytes_depend_neither_on_processes_nor_on_interruptions(here: Path) -> None:
    for name, counts, jobs in (("a", (3,), 1), ("b", (1, 3), 1), ("c", (3,), 2)):
        for count in counts:
            record(augment_plan(Path("demos"), (), Path(name), count), workers=jobs)
    assert bytes_of(here / "a") == bytes_of(here / "b") == bytes_of(here / "c")


@pytest.mark.usefixtures("here")
def test_what_fails_is_kept_with_the_reason(tmp_path: Path) -> None:
    """A crate out of reach."""
    (tmp_path / "cell.scene.yaml").write_text(SCENE.replace("xy: [0.45, -0.2]", "xy: [1.0, -0.6]"))
    (tmp_path / "stack.task.yaml").write_text(TASK)
    done = run("augment", "demos", str(tmp_path), "-n", "1", "-o", "never", "--max-attempts", "1", "--json")
    assert done.code == 1 and done.json["demonstrations"] == 0
    assert done.json["failures"] == {"gave up": 1}
    assert "OnTop(cube, crate): no segment can be carried out" in done.json["reasons"]["gave up"]
    (failure,) = done.json["rates"]["failures"]
    assert failure.startswith("gave up: OnTop(cube, crate): unreachable")
    assert [(one["subgoal"], one["rate"]) for one in done.json["rates"]["subgoals"]] == [("Grasped(cube)", 1.0)]


@pytest.mark.slow  # 3 s
@pytest.mark.usefixtures("here")
def test_other_objects_and_other_names_are_served_by_the_same_skills(tmp_path: Path) -> None:
    """A taller cube of another name on a wider crate."""
    scene = SCENE.replace("cube:", "brick:").replace("[0.04, 0.04, 0.04]", "[0.04, 0.04, 0.06]")
    (tmp_path / "cell.scene.yaml").write_text(scene.replace("[0.16, 0.16, 0.05]", "[0.2, 0.2, 0.08]"))
    (tmp_path / "stack.task.yaml").write_text(TASK.replace("cube", "brick"))
    found = sf.augment_demonstrations("demos", tmp_path, out="bricks", count=1, max_attempts=2)
    (demo,) = found
    brick = demo.states["objects"][-1][demo.about["objects"].index("brick")]
    assert brick[2] == pytest.approx(0.08 + 0.03, abs=0.003)
    assert [one["subgoal"] for one in demo.origin["segments"]] == ["Grasped(brick)", "OnTop(brick, crate)"]


@pytest.mark.parametrize(("arguments", "message"), [
    (("demos", "--seed", "0"), "with seed 0, the initial states would be those of the demonstrations"),
    (("demos", "-o", "demos"), "contains the demonstrations to augment"),
    (("demos", "--use", "5"), "contains only 2 demonstrations, not 5"),
    (("empty",), "does not contain demonstrations"),
    (("demos", "moved.task.yaml"), "achieves anything like `At(cube, 0.6, -0.1)`, which task `stack` requires"),
    (("demos", "--noise", "1"), "0.1"),
])  # fmt: skip
def test_mistakes_are_reported_in_one_sentence(here: Path, arguments: tuple[str, ...], message: str) -> None:
    (here / "empty").mkdir(exist_ok=True)
    goal = '{all: ["OnTop(cube, crate)", "Released(cube)"]}'
    (here / "moved.task.yaml").write_text(TASK.replace(goal, "At(cube, 0.6, -0.1)"))
    done = run("augment", *arguments, "-n", "1", *(() if "-o" in arguments else ("-o", "wrong")))
    assert done.code == 2 and message in done.err and "Traceback" not in done.err


@pytest.mark.usefixtures("here")
def test_a_library_of_other_robots_is_refused(tmp_path: Path) -> None:
    (tmp_path / "cell.scene.yaml").write_text(SCENE.replace("  arm: {", "  hand: {"))
    (tmp_path / "stack.task.yaml").write_text(TASK)
    with pytest.raises(SimfoundryError, match=r"recorded with `arm` .*, not with `hand`"):
        sf.augment_demonstrations("demos", tmp_path, out="robots", count=1)


def test_rates_of_a_damaged_origin_are_left_out(cell: Path, tmp_path: Path) -> None:
    shutil.copytree(cell / "demos", tmp_path / "demos")
    report = augment_report(tmp_path / "demos")  # recorded by the expert: no origin
    assert report.total == Rate(2, 2) and not report.sources and not report.subgoals
    assert json.loads(json.dumps(report.to_json()))["success"]["successes"] == 2
