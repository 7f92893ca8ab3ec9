"""Tasks: done before they start, too wide, too far, out of view."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from tests.lint.scenes import ARM, codes, findings, found, task, written

CUP = "shape: {cylinder: {radius: 0.04, height: 0.1}}, mass: 0.2"
THINGS = f"""
    cup: {{{CUP}, pose: {{xyz: [0.4, 0.2, 0.05]}}}}
    plate: {{shape: {{cylinder: {{radius: 0.1, height: 0.02}}}}, mass: 0.4, pose: {{xyz: [0.4, -0.2, 0.01]}}}}
    far: {{{CUP}, pose: {{xyz: [0.9, 0.3, 0.05]}}}}
"""


def lint_task(folder: Path, goal: str, more: str = "", scene: str = ARM) -> list[tuple[str, str]]:
    written(folder, THINGS, scene)
    return found(task(folder, goal, more))


@pytest.mark.parametrize(
    "goal",
    [
        "OnTop(cup, plate)",
        "{all: [OnTop(cup, desk), OnTop(cup, plate)]}",
        "{any: [OnTop(cup, plate), Grasped(cup)]}",
        "{not: OnTop(cup, desk)}",
        "Grasped(cup)",
        "NextTo(cup, plate)",
    ],
)
def test_what_is_still_to_be_done_is_clean(goal: str, tmp_path: Path) -> None:
    assert lint_task(tmp_path, f'"{goal}"' if goal[0] != "{" else goal) == []


@pytest.mark.parametrize(
    "goal",
    [
        "OnTop(cup, desk)",
        "{all: [OnTop(cup, desk), Upright(cup), Released(cup)]}",
        "{any: [Grasped(cup), LeftOf(cup, plate)]}",
        "{not: OnTop(cup, plate)}",
    ],
)
def test_a_goal_that_is_true_already(goal: str, tmp_path: Path) -> None:
    ((code, message),) = lint_task(tmp_path, goal)
    assert code == "SF405"
    assert "true at the start" in message


def test_a_goal_is_judged_at_the_start_of_the_task(tmp_path: Path) -> None:
    start = "start: {place: {cup: {on: plate}}}\n"
    assert lint_task(tmp_path, "OnTop(cup, plate)", start)[0][0] == "SF405"
    assert lint_task(tmp_path, "OnTop(cup, desk)", start) == []
    assert lint_task(tmp_path, "OnTop(cup, desk)", "start: {pose: {cup: {xyz: [0.4, -0.2, 0.07]}}}\n") == []


def test_what_a_reset_moves_is_not_judged_by_its_place(tmp_path: Path) -> None:
    reset = "reset: {objects: {cup: {x: [0.3, 0.5], y: [-0.2, 0.2]}}}\n"
    assert lint_task(tmp_path, "LeftOf(cup, plate)")[0][0] == "SF405"
    assert lint_task(tmp_path, "LeftOf(cup, plate)", reset) == []
    assert lint_task(tmp_path, "Upright(cup)", reset)[0][0] == "SF405"


def test_steps_are_judged_at_starts_of_their_own(tmp_path: Path) -> None:
    steps = "subtasks:\n  one: {goal: Grasped(cup)}\n  two: {goal: OnTop(cup, desk)}\n"
    assert lint_task(tmp_path, "OnTop(cup, plate)", steps) == []
    steps = "subtasks:\n  one: {goal: Grasped(cup), start: {place: {cup: {on: plate}}}}\n"
    steps += "  two: {goal: OnTop(cup, plate), start: {place: {cup: {on: plate}}}}\n"
    ((code, message),) = lint_task(tmp_path, "OnTop(cup, plate)", steps)
    assert code == "SF405"
    assert message.startswith("the `two` step is already complete when it starts")
    assert lint_task(tmp_path, "OnTop(cup, plate)", "subtasks: {one: {goal: Upright(cup)}}\n")[0][0] == "SF405"


# -- widths ---------------------------------------------------------------------------------------------------------

LATHE = "shape: {lathe: {profile: [%s]}}, mass: 0.3, pose: {xyz: [0.4, 0.2, 0]}"
WIDE = {
    "cylinder": "shape: {cylinder: {radius: 0.075, height: 0.06}}, mass: 0.3, pose: {xyz: [0.4, 0.2, 0.03]}",
    "lathe": LATHE % "[0, 0], [0.075, 0], [0.075, 0.06], [0, 0.06]",
    "lathe with a dimple": LATHE % "[0, 0], [0.075, 0], [0.075, 0.06], [0.01, 0.06], [0, 0.055]",
}


@pytest.mark.parametrize("shape", WIDE)
def test_what_is_wider_than_the_gripper(shape: str, tmp_path: Path) -> None:
    arm = "robots: {arm: {model: franka_robotiq, opening: 0.08}}\n"
    written(tmp_path, f"it: {{{WIDE[shape]}}}", arm)
    ((code, message),) = found(task(tmp_path, "Lifted(it)"))
    assert code == "SF407"
    assert message.startswith("`it` is 15.0 cm wide at its narrowest") or "14." in message


def test_only_what_must_be_carried_is_measured(tmp_path: Path) -> None:
    ((code, message),) = lint_task(tmp_path, "OnTop(plate, cup)")
    assert (code, message) == (
        "SF407",
        "`plate` is 19.7 cm wide at its narrowest, but `arm` opens only 8.5 cm",
    )
    assert lint_task(tmp_path, '"NextTo(plate, cup)"') == []
    assert (
        lint_task(tmp_path, "OnTop(plate, cup)", scene="robots: {arm: {model: franka_robotiq, opening: 0.2}}\n") == []
    )
    assert lint_task(tmp_path, "OnTop(plate, cup)", scene="") == []
    assert lint_task(tmp_path, "{any: [OnTop(plate, cup), OnTop(cup, plate)]}") == []
    own = "robots: {arm: {model: {urdf: arm.urdf}}}\n"
    (tmp_path / "arm.urdf").write_text("<robot/>")
    assert [code for code, _ in lint_task(tmp_path, "OnTop(plate, cup)", scene=own)] == ["SF214"]  # it has no hand


# -- reach ----------------------------------------------------------------------------------------------------------


def test_what_is_out_of_reach(tmp_path: Path) -> None:
    ((code, message),) = lint_task(tmp_path, "OnTop(far, plate)")
    nearest = math.hypot(0.86, 0.26)
    assert (code, message) == ("SF408", f"`far` is {nearest:.2f} m from `arm`, which reaches 0.855 m")
    assert lint_task(tmp_path, "OnTop(cup, far)")[0][0] == "SF408"
    assert lint_task(tmp_path, "{not: OnTop(far, cup)}") == [
        ("SF405", "the goal is already true at the start: `far` is 38.2 cm away from `cup`"),
    ]
    two = "robots: {arm: {model: franka_robotiq}, other: {model: franka_robotiq, pose: {xyz: [1.4, 0, 0]}}}\n"
    assert lint_task(tmp_path, "OnTop(far, plate)", scene=two) == []
    assert lint_task(tmp_path, "OnTop(far, plate)", "robots: [arm]\n", scene=two)[0][0] == "SF408"
    assert lint_task(tmp_path, "OnTop(far, plate)", scene="robots: {arm: {model: franka_robotiq, reach: 0.9}}\n") == []


def test_a_start_within_reach_is_a_start_within_reach(tmp_path: Path) -> None:
    assert lint_task(tmp_path, "OnTop(far, plate)", "start: {pose: {far: {xyz: [0.5, 0, 0.05]}}}\n") == []


@pytest.mark.parametrize(("x", "seen"), [(0.6, False), (0.99, True)])
def test_the_farthest_corner_of_a_reset_counts(x: float, seen: bool, tmp_path: Path) -> None:
    reset = f"reset:\n  objects:\n    cup: {{x: [0.3, {x}], y: [-0.1, 0.1]}}\n"
    path = task(tmp_path, "OnTop(cup, plate)", reset)
    written(tmp_path, THINGS, ARM)
    assert codes(path) == (["SF408"] if seen else [])
    for d in findings(path):
        assert d.path == "reset.objects.cup"
        assert f"({x:g}, -0.1)" in d.message


# -- view -----------------------------------------------------------------------------------------------------------

CAMERA = "cameras: {{eye: {{size: [640, 480], fx: 600, fy: 600, pose: {{xyz: [0, 0, 1], {0}}}}}{1}}}\n"


@pytest.mark.parametrize(
    ("x", "y", "seen"),
    [
        (0.0, 0.0, True),
        (0.5, 0.0, True),
        (0.55, 0.0, True),  # its side is still in the picture
        (0.65, 0.0, False),
        (0.0, 0.41, True),
        (0.0, 0.5, False),
        (0.6, 0.45, False),
    ],
)
def test_what_no_camera_sees(x: float, y: float, seen: bool, tmp_path: Path) -> None:
    # Looking down, the picture is 640 pixels along x and 480 along y: 0.533 m and 0.4 m to each side, on the desk.
    eye = CAMERA.format("quat_wxyz: [0, 1, 0, 0]", "")
    cube = f"cube: {{shape: {{box: [0.1, 0.1, 0.1]}}, mass: 0.1, pose: {{xyz: [{x}, {y}, 0.05]}}}}"
    assert codes(written(tmp_path, cube, eye)) == ([] if seen else ["SF409"])
    assert codes(written(tmp_path, cube.replace("mass: 0.1", "fixed: true"), eye)) == []


def test_one_camera_that_sees_it_is_enough(tmp_path: Path) -> None:
    cube = "cube: {shape: {box: [0.1, 0.1, 0.1]}, mass: 0.1, pose: {xyz: [0.3, 0, 0.05]}}"
    away = CAMERA.format("look_at: [-1, 0, 0.9]", "{0}")
    other = ", two: {size: [64, 48], fx: 60, fy: 60, pose: {xyz: [-1, 0, 0.5], look_at: [0, 0, 0]}}"
    wrist = ", wrist: {size: [64, 48], fx: 60, fy: 60, mount: arm.hand, pose: {xyz: [0, 0, 0], look_at: [0, 0, 1]}}"
    assert found(written(tmp_path, cube, away.replace("{0}", ""))) == [("SF409", "`cube` is outside the view of `eye`")]
    assert found(written(tmp_path, cube, away.replace("{0}", other))) == []
    assert codes(written(tmp_path, cube, ARM + away.replace("{0}", wrist))) == ["SF409"]
    riding = (
        "cameras: {eye: {size: [64, 48], fx: 60, fy: 60, mount: cube, pose: {xyz: [0, 0, 0.5], look_at: [0, 0, 0]}}}\n"
    )
    assert codes(written(tmp_path, cube, riding)) == []


def test_a_start_out_of_view_is_found_in_the_task(tmp_path: Path) -> None:
    eye = CAMERA.format("look_at: [0.4, 0, 0]", "")
    written(tmp_path, THINGS.replace("far", "near").replace("[0.9, 0.3", "[0.6, 0.1"), ARM + eye)
    path = task(tmp_path, "OnTop(cup, plate)", "start: {place: {cup: {on: desk, xy: [-0.8, 0]}}}\n")
    assert [(d.code, d.path) for d in findings(path)] == [("SF409", "start.place.cup")]
