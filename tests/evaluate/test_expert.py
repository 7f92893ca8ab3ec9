"""The scripted expert's parts that need no robot: lines through solids, the pace of paths, the plan of a task."""

from __future__ import annotations

import numpy as np
import pytest

from simfoundry.evaluate.expert.candidates import down, grasps
from simfoundry.evaluate.expert.joints import DrivenJoint, joint_of
from simfoundry.evaluate.expert.motion import LINE
from simfoundry.evaluate.expert.policy import Skill, hands_on, steps
from simfoundry.evaluate.expert.pushing import PushedEdge
from simfoundry.evaluate.expert.skills import DROP, until_height
from simfoundry.evaluate.expert.two_hands import motion_over
from simfoundry.evaluate.expert.worker import HAND, JOINT, paced, wobbled
from simfoundry.evaluate.task import load_task
from simfoundry.geometry.crossings import crossings, met
from simfoundry.geometry.frames import Array, Pose, quat_from_rpy
from simfoundry.robots.arm import Jaws
from simfoundry.scene.lower import lower_file
from simfoundry.scene.model import Scene
from simfoundry.scene.object_shapes import solid
from simfoundry.scene.state import SceneState
from tests.conftest import REPOSITORY

X, Z = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])


@pytest.fixture(scope="module")
def scene() -> Scene:
    return lower_file(REPOSITORY / "specs" / "scenes" / "marker_in_cup.scene.yaml")


def test_a_line_through_a_cup_meets_two_walls(scene: Scene) -> None:
    state = SceneState.initial(scene)
    cup = solid(scene.object("cup"), state)
    middle = state.poses["cup"].p
    (spans,) = crossings(cup, np.array([middle + [0.0, 0.0, 0.08]]), X)
    assert len(spans) == 2
    left, right = spans
    assert left.width == pytest.approx(0.0032, abs=3e-4) and right.width == pytest.approx(0.0032, abs=3e-4)
    outer = 0.03 + 0.08 / 0.095 * 0.01  # the wall of the asset leans outward by 1 cm
    assert right.end == pytest.approx(outer, rel=0.03) and left.start == pytest.approx(-outer, rel=0.03)
    assert right.facing > 0.95


def test_rays_meet_the_walls_of_a_cup_from_within_and_leave_by_its_mouth(scene: Scene) -> None:
    state = SceneState.initial(scene)
    cup = solid(scene.object("cup"), state)
    inside = state.poses["cup"].p + [0.0, 0.0, 0.05]
    assert met(cup, inside, np.array([X, -X, -Z, Z])).tolist() == [True, True, True, False]


def test_a_round_cup_is_grasped_in_the_same_way_however_it_is_turned(scene: Scene) -> None:
    jaws = Jaws(np.array([0.0, 1.0]), np.array([0.085, 0.0]), np.array([0.11, 0.11]), np.array([0.14, 0.14]))
    start = Pose.of([0.3, 0.0, 0.4], quat_from_rpy(np.pi, 0.0, 0.0))
    item, state = scene.object("cup"), SceneState.initial(scene)
    found = []
    for yaw in (0.0, 0.4, 1.3, 2.9):
        turned = Pose.of(state.poses["cup"].p, quat_from_rpy(0.0, 0.0, yaw))
        shape = solid(item, SceneState({**state.poses, "cup": turned}, state.joints, state.motions))
        found.append(grasps(shape, turned.p, jaws, down(), start)[0].X_WH)
    for X_WH in found[1:]:
        assert X_WH.angle_to(found[0]) < np.radians(35) and np.abs(X_WH.p - found[0].p).max() < 0.01


def test_a_path_is_gone_from_rest_to_rest_within_the_speeds() -> None:
    def hand(q: Array) -> Pose:
        return Pose.of([0.5 * q[0], 0.0, 0.0])

    hz = 15.0
    path = [np.array([0.0, 0.0]), np.array([1.0, -0.4]), np.array([1.2, 1.5])]
    gone = np.array([path[0], *paced(path, hand, hz)])
    assert gone[-1] == pytest.approx(path[-1])
    steps_taken = np.diff(gone, axis=0)
    assert np.abs(steps_taken).max() <= JOINT / hz * 1.01
    assert np.abs(0.5 * steps_taken[:, 0]).max() <= HAND / hz * 1.01
    assert np.abs(steps_taken[[0, -1]]).max() < 0.25 * np.abs(steps_taken).max()


def test_noise_bends_a_path_but_not_its_end() -> None:
    targets = [np.array([0.1 * k, -0.2]) for k in range(1, 41)]
    assert wobbled(targets, 0.0, np.random.default_rng(0)) is targets
    first, again, other = (np.array(wobbled(targets, 0.01, np.random.default_rng(seed))) for seed in (0, 0, 1))
    assert np.array_equal(first, again) and not np.allclose(first, other)
    off = np.abs(first - np.array(targets))
    assert off[-1].max() < 1e-9 and 0.002 < off.max() < 0.06
    assert np.abs(np.diff(off, axis=0)).max() < 0.01  # smooth: no jump from one step to the next


@pytest.mark.parametrize("height, end", [(0.3, [0.35]), (0.02, [0.07]), (0.5, [0.4]), (0.0, [0.06])])
def test_a_path_down_ends_where_the_object_is_released(height: float, end: list[float]) -> None:
    """A hand at the height of its only joint holds an object 5 cm below it."""
    path = [np.array([z]) for z in (0.4, 0.2, 0.06)]
    cut = until_height(path, lambda q: Pose.of([0.0, 0.0, q[0]]), Pose.of([0.0, 0.0, -0.05]), height)
    assert cut[-1] == pytest.approx(end) and [q.tolist() for q in cut[:-1]] == [
        q.tolist() for q in path[: len(cut) - 1]
    ]


@pytest.mark.parametrize(
    ("task", "expected"),
    [
        ("cup_in_bowl", [(Skill.PUT_IN, "Inside(cup, bowl)")]),
        ("serve_fruits", [(Skill.PUT_ON, "OnTop(banana, green_plate)"), (Skill.PUT_ON, "OnTop(apple, green_plate)")]),
        (
            "store_marker",
            [
                (Skill.OPEN, "Open(cabinet.drawer)"),
                (Skill.PUT_IN, "Inside(marker, cabinet.drawer)"),
                (Skill.CLOSE, "Closed(cabinet.drawer)"),
            ],
        ),
    ],
)
def test_a_task_becomes_skills_in_its_order(task: str, expected: list[tuple[Skill, str]]) -> None:
    loaded = load_task(REPOSITORY / "specs" / "tasks" / f"{task}.task.yaml")
    assert [(step.skill, step.until) for step in steps(loaded.goal, loaded.subtasks)] == expected


@pytest.mark.parametrize(
    ("task", "thing", "robots"), [("pot_on_stove", "pot", ("left", "right")), ("cup_in_bowl", "cup", ())]
)
def test_an_object_that_both_robots_must_grasp_is_moved_with_two_hands(
    task: str, thing: str, robots: tuple[str, ...]
) -> None:
    assert hands_on(load_task(REPOSITORY / "specs" / "tasks" / f"{task}.task.yaml"), thing) == robots


def test_an_object_in_two_hands_is_lifted_over_its_placement_in_small_steps() -> None:
    start, goal = Pose.of([0.2, 0.0, 0.0]), Pose.of([0.5, 0.1, 0.06], quat_from_rpy(0.0, 0.0, 0.3))
    poses = list(motion_over(start, goal, 0.1))
    assert poses[0] is start and np.allclose(poses[-1].p, [0.5, 0.1, 0.06 + DROP])
    points = np.array([X_WO.p for X_WO in poses])
    assert points[:, 2].max() == pytest.approx(0.16)
    assert np.linalg.norm(np.diff(points, axis=0), axis=1).max() <= LINE + 1e-9
    aside = np.linalg.norm(points[:, :2] - start.p[:2], axis=1)
    moving = (aside > 1e-9) & (aside < np.linalg.norm(goal.p[:2] - start.p[:2]) - 1e-9)
    assert points[moving, 2].min() == pytest.approx(0.16)


def test_a_lid_is_pushed_at_the_edge_of_its_tab_from_below_to_open_and_from_behind_to_close() -> None:
    scene = lower_file(REPOSITORY / "specs" / "scenes" / "throw_away_trash.scene.yaml")
    item, state = scene.object("trash_can"), SceneState.initial(scene)
    lid = DrivenJoint(item, state, joint_of(item, "lid"))
    edge = PushedEdge.of(lid, lid.ends[1])
    # The asset's hinge is 9.2 cm behind the center, and the tab ends 21.2 cm from the hinge; it is 6 mm thick.
    assert edge.reach == pytest.approx(0.212, abs=1e-3) and edge.back == pytest.approx(0.003, abs=1e-4)
    assert edge.ahead @ Z > 0.999 and state.poses["trash_can"].inverse().apply(edge.p)[0] == pytest.approx(
        0.12, abs=1e-3
    )
    for X_WH in edge.hands(0.15, 0.02):
        tip = X_WH.apply(0.15 * Z)
        assert tip[2] == pytest.approx(edge.p[2] - 0.003 - 0.02, abs=1e-3) and X_WH.rotation[2, 2] < 0.11
    opened = SceneState(state.poses, {**state.joints, "trash_can.lid": lid.ends[1]}, state.motions)
    back = PushedEdge.of(DrivenJoint(item, opened, joint_of(item, "lid")), lid.ends[0])
    out = state.poses["trash_can"].rotation[:, 0]
    assert back.ahead @ out > 0.9  # toward the mouth of the can
