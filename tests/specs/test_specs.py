"""The specs that people copy: they say what the paper says, stand still, and compile for every target."""

from __future__ import annotations

import math
import re
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

from simfoundry.backends import BACKENDS, compile_scene
from simfoundry.geometry.frames import Array, Pose, quat_from_rpy
from simfoundry.scene.object_shapes import world_bounds
from simfoundry.scene.state import SceneState
from simfoundry.spec.change.format import format_file
from simfoundry.spec.load import load
from simfoundry.spec.models.predicate import parse_call, texts
from simfoundry.spec.models.scene import SceneSpec
from simfoundry.spec.yaml.text import read
from simfoundry.worlds import open_world
from tests.specs.documents import (
    ASSETS,
    GALLERY,
    SCENES,
    SPECS,
    TASKS,
    footprint,
    lowered,
    name_of,
    scene_of_task,
    swept,
    task_at,
)

EVERYTHING = sorted(p for p in SPECS.rglob("*.yaml"))
BALLS = ("baseball", "tennis_ball")
CELLS = ("droid", "yam")
"""Scenes without things, which the others extend."""

REACHABLE = (0.35, 0.75)
"""How far from the base of the arm a thing of the DROID tasks starts [m]."""

PAPER = {
    "cup_in_bowl": ("Pick up the cup, and put the cup inside the bowl.", 3),
    "marker_in_cup": ("Pick up the marker, and put the marker in the cup.", 3),
    "serve_fruits": ("Put both the banana and the apple on the green plate.", 4),
    "clear_table": ("Put all objects in the brown box", 5),
    "stack_dishware": ("Put the bowl on the plate, then put the cup in the bowl.", 4),
    "store_marker": ("Open drawer, pick up marker, place marker in drawer, then close drawer.", 4),
    "throw_away_trash": (
        "Open the trash can, pick up the cup, put the cup into the trash can, and then close the trash can.",
        4,
    ),
    "pot_on_stove": ("Put the pot on the stove", 4),
}
"""Instruction and number of steps in the rubric of each task (paper, section Task Rubric)."""

COUSINS = {
    "Inside(baseball, bowl)": "Pick up the baseball, then put it in the bowl.",
    "OnTop(black_eraser, organizer)": "Pick up the black eraser, then put it on the organizer.",
    "Inside(burger, bowl)": "Pick up the burger, then place the burger in the bowl.",
    "OnTop(orange_marker, organizer)": "Pick up the orange marker, then put the orange marker on the organizer.",
    "Inside(red_bottle, bowl)": "Pick up the red bottle, then put the bottle in the bowl.",
    "Inside(red_marker, blue_cup)": "Pick up the red marker, then put the red marker in the cup.",
    "Inside(tennis_ball, bowl)": "Pick up the tennis ball, then put the tennis ball in the bowl.",
    "OnTop(tennis_ball, organizer)": "Pick up the tennis ball, then put the tennis ball on the organizer.",
    "OnTop(black_marker, plate)": "Pick up the black marker, then put the black marker on the plate.",
    "OnTop(black_eraser, bowl)": "Pick up the black eraser, then put the black eraser in the bowl.",
    "OnTop(orange_cup, bowl)": "Pick up the orange cup, then put the orange cup in the bowl.",
    "OnTop(orange_cup, organizer)": "Pick up the orange cup, then put the orange cup on the organizer.",
    "OnTop(red_marker, organizer)": "Pick up the red marker, then put the red marker on the organizer.",
}
"""Goal and instruction of the task cousins (paper, section Task Cousins Example)."""

each_document = pytest.mark.parametrize("path", EVERYTHING, ids=lambda p: p.name)
each_scene = pytest.mark.parametrize("path", SCENES, ids=name_of)
each_task = pytest.mark.parametrize("path", TASKS, ids=name_of)


@each_document
def test_nothing_is_found(path: Path) -> None:
    assert [(d.code, d.line, d.message) for d in load(path).all_findings()] == []


@each_document
def test_it_is_in_canonical_form(path: Path) -> None:
    assert format_file(path).after == path.read_text()


@pytest.mark.parametrize("path", [*ASSETS, *SCENES, *TASKS], ids=lambda p: p.name)
def test_it_is_called_as_its_file_and_says_what_it_is(path: Path) -> None:
    lines = path.read_text().splitlines()
    kind = path.name.split(".")[1]
    assert lines[1].startswith("# ") and lines[1].endswith(".") and lines[2] == f"simfoundry: {kind}/1"
    assert read(path).data["name"] == name_of(path)


def test_every_asset_is_used() -> None:
    used: set[Path] = set()
    for path in [*sorted((SPECS / "scenes").iterdir()), *ASSETS]:
        data = read(path).data
        named = [o.get("asset") for o in data.get("objects", {}).values()] + [data.get("extends")]
        used |= {(path.parent / n).resolve() for n in named if n}
    assert sorted(set(ASSETS) - used) == []


@each_scene
def test_nothing_moves_when_physics_starts(path: Path) -> None:
    scene = lowered(path)
    before = SceneState.initial(scene)
    with open_world(scene, "mujoco") as world:
        world.reset()
        world.step(round(0.4 / world.timestep))
        after = world.state()
    assert name_of(path) in CELLS or sum(not o.fixed for o in scene.objects) >= 2
    for name, X_WO in before.poses.items():
        assert np.linalg.norm(after.poses[name].p - X_WO.p) < 2e-3, name
        assert math.degrees(after.poses[name].angle_to(X_WO)) < 1.0, name
    for name, position in before.joints.items():
        assert after.joints[name] == pytest.approx(position, abs=math.radians(0.5)), name


@each_scene
@pytest.mark.parametrize("target", BACKENDS.names())
def test_it_compiles(path: Path, target: str) -> None:
    scene = lowered(path)
    artifact = compile_scene(scene, target)
    text = b"\n".join(d for f, d in artifact.files.items() if f.endswith((".xml", ".usda", ".json", ".urdf"))).decode()
    assert [o.name for o in scene.objects if f'"{o.name}"' not in text] == []


def test_the_tasks_are_those_of_the_paper() -> None:
    said = {name_of(p): (task_at(p)[1].instruction, len(task_at(p)[1].subtasks)) for p in TASKS}
    assert {n: s for n, s in said.items() if n in PAPER} == PAPER
    cousins = {p: task_at(p)[1] for p in TASKS if name_of(p) not in PAPER}
    goals = {next(texts(task.goal))[0]: task.instruction for task in cousins.values()}
    assert goals == COUSINS
    assert {task.scene for task in cousins.values()} == {"../scenes/cluttered.scene.yaml"}
    assert all(task.reset.grid == (5, 5) for p in TASKS for task in [task_at(p)[1]])


@each_task
def test_starts_do_not_meet(path: Path) -> None:
    """No two things overlap, wherever each of them starts, and all of them are on the desk."""
    from shapely.geometry import MultiPoint

    scene, (_, task) = scene_of_task(path), task_at(path)
    desk = next(o for o in scene.objects if o.name == "desk")
    ground = {o.name: swept(o, task.reset.objects.get(o.name)) for o in scene.objects if o is not desk}
    assert set(task.reset.objects) <= set(ground)
    top = MultiPoint(footprint(desk, desk.X_WO)).convex_hull
    assert [n for n, covered in ground.items() if not top.contains(covered)] == []
    moving = [pair for pair in combinations(ground, 2) if set(pair) & set(task.reset.objects)]
    assert [pair for pair in moving if ground[pair[0]].intersects(ground[pair[1]])] == []


@each_task
def test_the_scene_is_one_of_the_starts(path: Path) -> None:
    scene, (_, task) = scene_of_task(path), task_at(path)
    for o in scene.objects:
        if (region := task.reset.objects.get(o.name)) is not None:
            assert region.x[0] <= o.X_WO.p[0] <= region.x[1], o.name
            assert region.y[0] <= o.X_WO.p[1] <= region.y[1], o.name
            assert region.x[0] < region.x[1] and region.y[0] < region.y[1], o.name


@each_task
def test_what_is_moved_starts_in_reach(path: Path) -> None:
    loaded, task = task_at(path)
    scene = load(loaded.file(task.scene)).spec
    assert isinstance(scene, SceneSpec)
    if "arm" not in scene.robots:  # two arms: both reach the middle, none all of it
        assert task.robots is None and set(scene.robots) == {"left", "right"}
        return
    for name, region in task.reset.objects.items():
        far = [math.hypot(x, y) for x in region.x for y in region.y]
        assert REACHABLE[0] <= min(far) and max(far) <= REACHABLE[1], name


@each_task
def test_every_goal_is_about_something_that_starts_elsewhere(path: Path) -> None:
    """What the goal moves is in the reset, and what a policy lets go of is part of the goal."""
    _, task = task_at(path)
    calls = [parse_call(text) for text, _ in texts(task.goal)]
    moved = {c.args[0] for c in calls if c.predicate in ("Inside", "OnTop")}
    assert moved and moved <= set(task.reset.objects)
    assert {c.args[0] for c in calls if c.predicate == "Released"} <= moved
    assert any(c.predicate == "Released" for c in calls)
    steps = [text for step in task.subtasks.values() for text, _ in texts(step.goal)]
    assert {str(c) for c in calls if c.predicate in ("Inside", "OnTop", "Closed")} <= set(steps)


def test_assets_stand_on_their_frame() -> None:
    """A thing's frame is at its foot, so that a pose at height 0 stands on the desk; that of a ball is its center."""
    items = {o.name: o for o in lowered(GALLERY).objects if not o.fixed}
    assert sorted(items) == [name_of(p) for p in ASSETS]
    for name, item in items.items():
        low, high = world_bounds(item, Pose.of())
        assert low[2] == pytest.approx(-high[2] if name in BALLS else 0.0, abs=1e-6), name


def run(scene: str, moved: dict[str, Pose], joints: dict[str, float], seconds: float = 1.2) -> SceneState:
    """A scene some time after things were let go somewhere else."""
    whole = lowered(SPECS / "scenes" / f"{scene}.scene.yaml")
    start = SceneState.initial(whole)
    with open_world(whole, "mujoco") as world:
        world.reset(SceneState.of({**start.poses, **moved}, {**start.joints, **joints}))
        world.step(round(seconds / world.timestep))
        return world.state()


def offset(state: SceneState, name: str, other: str) -> Array:
    """Position of one thing's frame in another's [m], shape (3,)."""
    return (state.poses[other].inverse() @ state.poses[name]).p


def test_cups_and_bowls_are_hollow() -> None:
    upright = quat_from_rpy(0, math.pi / 2, 0)
    end = run("marker_in_cup", {"marker": Pose.of([0.52, -0.12, 0.12], upright)}, {})
    assert offset(end, "marker", "cup")[2] < 0.08  # its middle; it is 14 cm long and the cup 9.5 cm high
    assert np.linalg.norm(offset(end, "marker", "cup")[:2]) < 0.02
    end = run("stack_dishware", {"bowl": Pose.of([0.5, -0.24, 0.03]), "cup": Pose.of([0.5, -0.24, 0.06])}, {})
    assert offset(end, "bowl", "plate") == pytest.approx([0, 0, 0.01], abs=2e-3)
    assert offset(end, "cup", "bowl") == pytest.approx([0, 0, 0.01], abs=2e-3)


def test_a_drawer_takes_a_marker_and_stays_where_it_is_left() -> None:
    across = Pose.of([0.45, -0.12, 0.16], quat_from_rpy(0, 0, math.pi / 2))
    end = run("store_marker", {"marker": across}, {"cabinet.drawer": 0.15, "cabinet.bottom_drawer": 0.06})
    assert end.joints["cabinet.drawer"] == pytest.approx(0.15, abs=1e-3)
    assert end.joints["cabinet.bottom_drawer"] == pytest.approx(0.06, abs=1e-3)
    assert 0.11 < end.poses["marker"].p[2] < 0.14  # on the floor of the upper drawer, below its edge


def test_the_trash_can_takes_a_cup_and_its_lid_stays_open_or_falls_shut() -> None:
    cup = Pose.of([0.6, -0.12, 0.15], quat_from_rpy(0.3, 0, 0))
    end = run("throw_away_trash", {"cup": cup}, {"trash_can.lid": math.radians(100)})
    assert math.degrees(end.joints["trash_can.lid"]) == pytest.approx(105, abs=0.5)
    assert end.poses["cup"].p[2] < 0.03 and np.linalg.norm(offset(end, "cup", "trash_can")[:2]) < 0.04
    end = run("throw_away_trash", {}, {"trash_can.lid": math.radians(60)})
    assert math.degrees(end.joints["trash_can.lid"]) == pytest.approx(0, abs=0.5)


def test_the_readme_shows_every_scene_and_task() -> None:
    page = (SPECS / "README.md").read_text()
    linked = {(SPECS / target).resolve() for target in re.findall(r"\]\(([^)#]+)\)", page)}
    assert [p for p in linked if not p.exists()] == []
    assert set(SCENES) - linked == set()
    pictures = {p for p in linked if p.suffix == ".png"}
    assert {p.stem for p in pictures} == {name_of(p) for p in SCENES} - set(CELLS)
    assert [p.name for p in pictures if p.stat().st_size > 60_000] == []
    for path in TASKS:
        task = task_at(path)[1]
        row = next(line for line in page.splitlines() if f"](tasks/{path.name})" in line)
        assert (task.instruction if name_of(path) in PAPER else next(texts(task.goal))[0]) in row
