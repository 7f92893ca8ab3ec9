"""Cousins as documents: small, sound, true after reading, and the same from whatever process."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from simfoundry.cousins.layout.twin import Twin
from simfoundry.cousins.recipe import library
from simfoundry.cousins.recipe.candidate import Candidate
from simfoundry.cousins.recipe.document import claim_project, read_recipe, relative
from simfoundry.cousins.recipe.moved_objects import dependents
from simfoundry.cousins.run.candidates import CandidateSampler
from simfoundry.cousins.tasks.context import TaskContext
from simfoundry.cousins.tasks.proposals import TaskCousin
from simfoundry.cousins.tasks.witness import Witness, witness
from simfoundry.errors import OutputError
from simfoundry.evaluate.task import load_task
from simfoundry.predicates import Judge
from simfoundry.scene.lower import lower
from simfoundry.scene.state import SceneState
from simfoundry.spec.load import load, load_scene
from simfoundry.spec.models.scene import SceneSpec
from simfoundry.spec.models.task import TaskSpec
from simfoundry.worlds.mujoco_world import MujocoWorld
from tests.cli.command import run
from tests.conftest import REPOSITORY
from tests.cousins.conftest import TABLE
from tests.cousins.recipe.test_library import BALL, BRICK

TASK = """\
simfoundry: task/1
name: chip_on_post
scene: table.scene.yaml
instruction: Put the chip on the post.
goal: OnTop(chip, post)
start: {place: {can: {on: table, xy: [-0.2, 0.1]}}}
reset:
  objects: {can: {x: [-0.25, -0.15], y: [0.05, 0.15]}}
"""
RECIPE = """\
simfoundry: cousins/1
name: tables
twin: {twin}
seed: 11
scene:
  anchor: post
  objects: {{brick: [LeftOf, RightOf], can: [InFrontOf, Behind]}}
  gap: [0.02, 0.15]
distractors: {{count: [1, 2], library: things, builtin_library: false}}
"""


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """A project with a table, a task on it, a library of two things and recipes over the scene and the task."""
    (tmp_path / "simfoundry.yaml").write_text("")
    (tmp_path / "table.scene.yaml").write_text(TABLE)
    (tmp_path / "chip.task.yaml").write_text(TASK)
    (tmp_path / "things").mkdir()
    (tmp_path / "things" / "ball.asset.yaml").write_text(BALL)
    (tmp_path / "things" / "brick.asset.yaml").write_text(BRICK)
    for name, twin in (("scenes", "table.scene.yaml"), ("tasks", "chip.task.yaml")):
        (tmp_path / f"{name}.cousins.yaml").write_text(RECIPE.format(twin=twin))
    return tmp_path


def setup(project: Path, name: str, seed: int = 11) -> tuple[Path, Path, int]:
    return project / f"{name}.cousins.yaml", project / "out", seed


def first_accepted(asked: tuple[Path, Path, int]) -> Candidate:
    return next(c for c in map(CandidateSampler.load(*asked), range(1, 30)) if c.accepted)


def written(project: Path, one: Candidate) -> dict[str, Path]:
    (project / "out").mkdir(exist_ok=True)
    paths = {kind: project / "out" / name for kind, name in one.files().items()}
    for kind, path in paths.items():
        path.write_text(one.documents[kind])
    return paths


def test_a_cousin_says_only_what_differs_and_is_true_when_read(project: Path) -> None:
    one = first_accepted(setup(project, "scenes"))
    path = written(project, one)["scene"]
    loaded = load(path)
    assert loaded.all_findings() == []
    data = loaded.document.root.value if loaded.document is not None else {}
    assert isinstance(data, dict)
    assert run("fmt", "--check", path).code == 0
    moved = {"brick", "chip", "can"}
    assert isinstance(loaded.spec, SceneSpec)
    added = set(loaded.spec.objects) - {"table", "post", "brick", "chip", "can"}
    assert 1 <= len(added) <= 2
    text = path.read_text()
    assert {n for n in loaded.spec.objects if f"\n  {n}:" in text} == moved | added, "the chip rides on the brick"
    scene = lower(load_scene(path))
    judge, state = Judge(scene), SceneState.initial(scene)
    assert len(one.asked) == 2
    for relation in (*one.asked, *loaded.spec.relations):
        assert judge(relation, state).value, relation
    assert set(one.asked) <= set(loaded.spec.relations) and "OnTop(chip, brick)" in loaded.spec.relations
    origin = loaded.spec.origin
    assert origin is not None and origin.cousin is not None
    assert (origin.cousin.recipe, origin.cousin.seed, origin.cousin.index) == ("tables", 11, one.index)
    assert loaded.spec.name == f"tables_{one.index:06d}"


def test_a_task_comes_along_without_what_was_said_of_moved_things(project: Path) -> None:
    one = first_accepted(setup(project, "tasks"))
    paths = written(project, one)
    loaded = load(paths["task"])
    assert loaded.all_findings() == [] and isinstance(loaded.spec, TaskSpec)
    spec = loaded.spec
    assert spec.goal == "OnTop(chip, post)" and spec.scene == paths["scene"].name
    assert not spec.start.place and not spec.reset.objects
    assert run("check", project / "out").code == 0


@pytest.mark.slow  # 2 s
def test_a_candidate_depends_on_nothing_but_its_index(project: Path) -> None:
    asked = setup(project, "scenes")
    one, other = CandidateSampler.load(*asked), CandidateSampler.load(*asked)
    first = [one(k).line() for k in (1, 2, 3, 4)]
    assert [other(k).line() for k in (4, 2, 3, 1)] == [first[k - 1] for k in (4, 2, 3, 1)]
    program = (
        "import sys; from pathlib import Path; from simfoundry.cousins.run.candidates import CandidateSampler;"
        "print(CandidateSampler.load(Path(sys.argv[1]), Path(sys.argv[2]), 11)(3).line())"
    )
    line = [sys.executable, "-c", program, str(asked[0]), str(asked[1])]
    done = subprocess.run(
        line,
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "PYTHONPATH": str(REPOSITORY), "PYTHONHASHSEED": "7"},
    )
    assert done.stdout.strip() == first[2]
    assert CandidateSampler.load(*setup(project, "scenes", 12))(1).line() != first[0]


def test_the_command_writes_cousins_a_manifest_and_a_page(project: Path) -> None:
    recipe = project / "scenes.cousins.yaml"
    done = run("cousins", recipe, "-n", "3", "-o", project / "out", "-j", "1", "--gallery", "1", "--json")
    assert done.code == 0, done.err
    assert done.json["accepted"] == 3 and done.json["end"] == "complete"
    assert len(list((project / "out").glob("*.scene.yaml"))) == 3
    page = (project / "out" / "gallery.html").read_text()
    assert page.count("<img ") == 1 and page.count("<figure>") == 1 and "2 more cousins are listed in" in page
    again = run("cousins", recipe, "-n", "3", "-o", project / "out", "-j", "1", "--gallery", "1")
    assert again.code == 0 and "3 of 3 cousins" in again.out
    told = run("diff", project / "table.scene.yaml", next((project / "out").glob("*.scene.yaml")))
    assert "origin: cousin " in told.out and "of recipe tables, seed 11" in told.out
    assert "brick" in told.out and " moved " in told.out


def test_a_place_from_which_the_twin_cannot_be_reached(project: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    recipe = read_recipe(project / "scenes.cousins.yaml")
    with pytest.raises(OutputError, match="must be located in its project"):
        claim_project(recipe, tmp_path_factory.mktemp("elsewhere"))
    assert relative(project / "table.scene.yaml", project / "a" / "b") == "../../table.scene.yaml"


def test_what_is_placed_by_words_moves_along() -> None:
    loaded = load(REPOSITORY / "specs" / "scenes" / "cup_in_bowl.scene.yaml")
    assert isinstance(loaded.spec, SceneSpec)
    assert dependents(loaded.spec, {"bowl"}) == {"cup"}
    assert dependents(loaded.spec, {"cup"}) == set()


def test_one_stage_holds_the_twin_and_every_cousin(project: Path) -> None:
    from pxr import Usd, UsdGeom

    recipe, stage = project / "scenes.cousins.yaml", project / "all.usda"
    done = run("cousins", recipe, "-n", "3", "-o", project / "out", "-j", "1", "--no-gallery", "--stage", stage)
    assert done.code == 0, done.err
    opened = Usd.Stage.Open(str(stage))
    choice = opened.GetPrimAtPath("/World").GetVariantSet("cousin")
    files = {f"c{p.name[:6]}": p for p in (project / "out").glob("*.scene.yaml")}
    assert sorted(choice.GetVariantNames()) == sorted([*files, "twin"])
    for name, file in {**files, "twin": project / "table.scene.yaml"}.items():
        choice.SetVariantSelection(name)
        found = {p.GetName(): UsdGeom.Xformable(p) for p in opened.GetPrimAtPath("/World/Objects").GetChildren()}
        scene = lower(load_scene(file))
        assert set(found) == {o.name for o in scene.objects}
        for item in scene.objects:
            moved = found[item.name].ComputeLocalToWorldTransform(0)
            assert tuple(moved.ExtractTranslation()) == pytest.approx(tuple(item.X_WO.p), abs=1e-6)
            axis = moved.TransformDir((1.0, 2.0, 3.0))
            assert tuple(axis) == pytest.approx(tuple(item.X_WO.rotation @ [1, 2, 3]), abs=1e-5)


TASKS = """\
simfoundry: cousins/1
name: errands
twin: chip.task.yaml
seed: 3
{scene}task: {{count: 2, objects: [chip, can, post]}}
"""
LAYOUT = "scene: {anchor: post, objects: {can: [InFrontOf, Behind]}, gap: [0.02, 0.15]}\n"


def test_tasks_of_their_own_in_the_scene_of_the_twin(project: Path) -> None:
    (project / "errands.cousins.yaml").write_text(TASKS.format(scene=""))
    done = run("cousins", project / "errands.cousins.yaml", "-n", "5", "-o", project / "out", "-j", "1", "--json")
    assert (done.code, done.json["end"]) == (1, "exhausted"), "there are no more tasks than the axis asks for"
    assert done.json["accepted"] == 2 and not list((project / "out").glob("*.scene.yaml"))
    goals = set()
    for path in sorted((project / "out").glob("*.task.yaml")):
        loaded = load(path)
        assert loaded.all_findings() == [] and isinstance(loaded.spec, TaskSpec)
        assert loaded.spec.scene == "../table.scene.yaml" and "can" in loaded.spec.start.place, "as the twin starts"
        assert loaded.spec.origin is not None and loaded.spec.origin.cousin is not None
        goals.add(str(loaded.spec.goal))
    assert len(goals) == 2


def test_tasks_and_layouts_together(project: Path) -> None:
    (project / "errands.cousins.yaml").write_text(TASKS.format(scene=LAYOUT))
    done = run("cousins", project / "errands.cousins.yaml", "-n", "3", "-o", project / "out", "-j", "1", "--no-gallery")
    assert done.code == 0, done.err
    tasks = sorted((project / "out").glob("*.task.yaml"))
    assert len(tasks) == len(list((project / "out").glob("*.scene.yaml"))) == 3
    for path in tasks:
        spec = load(path).spec
        assert isinstance(spec, TaskSpec) and spec.scene == path.name.replace("task", "scene")
        assert "can" not in spec.start.place, "the cousin has moved it"
    assert run("check", project / "out").code == 0


EVERYTHING = """\
simfoundry: cousins/1
name: everything
twin: cup.task.yaml
seed: 2
scene: {anchor: bowl, objects: {cup: [LeftOf, RightOf, InFrontOf, Behind]}, gap: [0.02, 0.15]}
object: {objects: {cup: {count: 2}}}
distractors: {count: [1, 2], library: things, builtin_library: false}
task: {count: 3}
"""
DESK = """\
simfoundry: scene/1
name: table
materials: {wood: {density: 600, friction: 0.5}}
objects:
  table: {fixed: true, shape: {box: [0.8, 0.8, 0.04]}, material: wood, pose: {xyz: [0, 0, -0.02]}}
  bowl: {asset: bowl.asset.yaml, place: {on: table, xy: [0.05, 0]}}
  cup: {asset: cup.asset.yaml, place: {on: table, xy: [-0.1, 0.15]}}
  post: {shape: {box: [0.05, 0.05, 0.05]}, material: wood, place: {on: table, xy: [-0.1, -0.2]}}
cameras:
  eye: {size: [640, 480], fx: 400, fy: 400, pose: {xyz: [-0.9, 0, 0.7], look_at: [0, 0, 0]}}
"""


@pytest.mark.slow  # 5 s: a whole run
def test_all_axes_together_and_what_they_wrote(project: Path) -> None:
    """Every cousin has another cup, in another place, more things beside it, and a task that can be done with it."""
    for name in ("bowl", "cup"):
        shutil.copy(REPOSITORY / "specs" / "assets" / f"{name}.asset.yaml", project)
    (project / "table.scene.yaml").write_text(DESK)
    (project / "cup.task.yaml").write_text(
        "simfoundry: task/1\nname: cup\nscene: table.scene.yaml\ninstruction: Put the cup in the bowl.\n"
        "goal: Inside(cup, bowl)\n"
    )
    (project / "everything.cousins.yaml").write_text(EVERYTHING)
    done = run("cousins", project / "everything.cousins.yaml", "-n", "3", "-o", project / "out", "-j", "1", "--json")
    assert done.code == 0, done.err
    goals = set()
    for path in sorted((project / "out").glob("*.task.yaml")):
        task = load_task(path)
        scene, judge = task.scene, Judge(task.scene)
        names = [o.name for o in scene.objects]
        assert 1 <= len(set(names) - {"table", "bowl", "cup", "post"}) <= 2
        text = path.with_name(path.name.replace("task", "scene")).read_text()
        assert "assets/objects/cup_" in text
        with MujocoWorld(scene) as world:
            world.reset()
            before = world.state()
            world.step(round(2 / world.timestep))
            after = world.state()
            assert max(c.depth for c in world.contacts()) < 1e-3
        assert all(np.linalg.norm(after.poses[n].p - before.poses[n].p) < 0.01 for n in names)
        assert not judge(task.goal, after).value
        loaded = load_scene(path.with_name(path.name.replace("task", "scene"))).spec
        assert isinstance(loaded, SceneSpec)
        (side,) = [r for r in loaded.relations if r.endswith("(cup, bowl)")]
        assert judge(side, after).value
        assert isinstance(witness(TaskContext(Twin.of(scene, task.goal, ()), ()), task.goal), Witness), task.goal
        goals.add(str(task.goal))
    assert len(goals) >= 2
    assert run("check", project / "out").code == 0


def test_what_no_longer_fits_is_no_cousin(project: Path) -> None:
    """Each may do for itself: the cup that is there now is too wide for the bowl of the twin."""
    for name in ("bowl", "cup"):
        shutil.copy(REPOSITORY / "specs" / "assets" / f"{name}.asset.yaml", project)
    wide = (project / "cup.asset.yaml").read_text()
    lathe = "[[0, 0], [0.03, 0], [0.04, 0.095], [0.0368, 0.095], [0.0276, 0.008], [0, 0.008]]"
    assert lathe in wide
    wide = wide.replace(lathe, "[[0, 0], [0.1, 0], [0.1, 0.05], [0.09, 0.05], [0.09, 0.01], [0, 0.01]]")
    (project / "wide.asset.yaml").write_text(wide)
    (project / "table.scene.yaml").write_text(DESK)
    twin = Twin.load(project / "table.scene.yaml")
    other = library.lowered(project / "wide.asset.yaml")
    goal = "Inside(cup, bowl)"
    spec = TaskSpec(simfoundry="task/1", name="cup", scene="table.scene.yaml", instruction="Put it in.", goal=goal)
    task = TaskCousin(spec, goal)
    assert task.reasons(twin, twin.state) == ()
    swapped = twin.extended([replace(other, name="cup", X_WO=twin.scene.object("cup").X_WO)])
    assert task.reasons(swapped, swapped.state) == (), "what is of the twin was proved there"
    (reason,) = task.reasons(swapped, swapped.state, {"cup"})
    assert reason.code == "impossible" and "Inside(cup, bowl) did not become true" in reason.text
    assert task.reasons(swapped, swapped.state, {"bottle"}) == (), "the goal is not about it"
