"""``simfoundry new``: what it writes is valid, canonical, and enough to start from."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from simfoundry.predicates import Judge
from simfoundry.scene.lower import lower_file
from simfoundry.scene.state import SceneState
from simfoundry.spec.change.format import format_file
from simfoundry.spec.editor.new import WORDS
from simfoundry.spec.editor.schema import schemas
from simfoundry.spec.load import load
from simfoundry.spec.models.asset import AssetSpec
from simfoundry.spec.models.kinds import KINDS
from simfoundry.spec.models.scene import SceneSpec
from simfoundry.spec.models.task import TaskSpec
from simfoundry.worlds import open_world
from simfoundry.worlds.mujoco_world import MujocoWorld
from simfoundry.worlds.settle import settle
from tests.cli.command import run

NAMED = ("scene", "task", "asset", "cousins", "policy", "dataset")
FILES = {kind: f"a.{kind}.yaml" for kind in NAMED} | {"capture": "shot/capture.yaml"}
MODELINE = re.compile(r"# yaml-language-server: \$schema=(\S+)\n")


@pytest.fixture(autouse=True)
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty project, with the working folder in it."""
    (tmp_path / "simfoundry.yaml").touch()
    monkeypatch.chdir(tmp_path)
    return tmp_path


def made(*args: str | Path) -> Path:
    done = run("new", *args, "--json")
    assert (done.code, done.err) == (0, ""), done
    return Path(done.json["file"])


def assert_clean(path: Path) -> None:
    """No finding, nothing to format, and a first line that leads to the schema of the kind."""
    assert [d.message for d in load(path).all_findings()] == []
    assert not format_file(path).changed
    named = MODELINE.match(path.read_text())
    assert named is not None
    file, _, part = named[1].partition("#")
    assert (path.parent / file).is_file() and part == "/$defs/Editor"


def test_there_is_a_start_for_every_kind() -> None:
    assert set(FILES) == set(WORDS) == {kind.partition("/")[0] for kind in KINDS}


@pytest.mark.parametrize("kind", FILES)
def test_what_is_made_is_clean(kind: str) -> None:
    made("first.scene.yaml")
    source = ["--from", "first.scene.yaml"] if kind in ("task", "cousins") else []
    path = made(kind, FILES[kind], *source)
    for name in ("color.png", "depth.png") if kind == "capture" else ():
        (path.parent / name).touch()
    assert_clean(path)
    schema = MODELINE.match(path.read_text())
    assert schema is not None and schema[1].endswith(f"/{kind}.schema.json#/$defs/Editor")
    assert path.read_text().count("#") > 3  # it teaches


@pytest.mark.parametrize("kind", FILES)
def test_the_kind_is_read_from_the_path_or_completes_it(kind: str) -> None:
    made("first.scene.yaml")
    source = ["--from", "first.scene.yaml"] if kind in ("task", "cousins") else []
    guessed = made(FILES[kind], *source)
    completed = made(kind, "b", *source)
    assert guessed == Path(FILES[kind])
    assert completed == Path("b/capture.yaml" if kind == "capture" else f"b.{kind}.yaml")
    assert f"\nname: {'shot' if kind == 'capture' else 'a'}\n" in guessed.read_text()
    assert "\nname: b\n" in completed.read_text()


def test_the_scene_shows_the_common_ways_and_comes_to_rest() -> None:
    path = made("desk.scene.yaml")
    spec = load(path).spec
    assert isinstance(spec, SceneSpec)
    assert spec.robots and spec.cameras and spec.lights and spec.relations and spec.materials
    ways = [o.model_fields_set for o in spec.objects.values()]
    assert any({"fixed", "pose"} <= w for w in ways) and any({"mass", "place", "material", "shape"} <= w for w in ways)
    assert any("mass" not in w and "place" in w for w in ways)
    with open_world(lower_file(path), "mujoco") as world:
        settled = settle(world)
    assert settled.passed


def test_a_task_is_about_the_objects_of_its_scene() -> None:
    made("desk.scene.yaml")
    task = load(made("task", "sub/stack.task.yaml", "--from", "desk.scene.yaml", "--name", "stack_it")).spec
    assert isinstance(task, TaskSpec)
    assert (task.name, task.scene) == ("stack_it", "../desk.scene.yaml")
    assert task.instruction == "Put the mug on the plate."
    assert list(task.reset.objects) == ["mug"] and task.reset.objects["mug"].x == (0.4, 0.5)


def test_a_task_with_one_thing_lifts_it(project: Path) -> None:
    (project / "one.scene.yaml").write_text(
        "simfoundry: scene/1\nname: one\nobjects:\n"
        "  red_box: {mass: 1, shape: {box: [0.1, 0.1, 0.1]}, place: {on: t}}\n"
        "  t: {fixed: true, shape: {box: [1, 1, 0.1]}}\nrobots: {arm: {model: demo_arm}}\n"
    )
    path = made("one.task.yaml")  # its scene is the only one beside it
    assert_clean(path)
    assert "- Lifted(red_box)\n" in path.read_text() and "instruction: Lift the red box." in path.read_text()
    # Where it is placed is not known before it is solved.
    assert not re.search("^ *objects:", path.read_text(), re.MULTILINE)
    assert_clean(made("one.cousins.yaml", "--from", "one.task.yaml"))


@pytest.mark.parametrize("kind", FILES)
def test_an_overlay_of_every_kind_is_clean(kind: str) -> None:
    made("first.scene.yaml")
    source = ["--from", "first.scene.yaml"] if kind in ("task", "cousins") else []
    base = made(kind, FILES[kind], *source)
    for name in ("color.png", "depth.png") if kind == "capture" else ():
        (base.parent / name).touch()
    over = made(kind, base.parent / f"over.{kind}.yaml", "--extends", base)
    assert_clean(over)
    assert f"\nextends: {base.name}\nname: over\n" in over.read_text()


def test_an_overlay_changes_one_thing() -> None:
    made("a.scene.yaml")
    before, after = load(Path("a.scene.yaml")).spec, load(made("b.scene.yaml", "--extends", "a.scene.yaml")).spec
    assert isinstance(before, SceneSpec) and isinstance(after, SceneSpec)
    changed = [n for n in before.objects if before.objects[n] != after.objects[n]]
    assert changed == ["mug"]
    assert after.objects["mug"].place is not None and after.objects["mug"].place.yaw_deg == 45


def test_schemas_are_written_once_and_those_of_the_project_are_used(project: Path) -> None:
    first = run("new", "a.scene.yaml")
    assert first.out.splitlines()[:2] == [
        "wrote a.scene.yaml",
        "wrote .simfoundry/schemas/, which editors use for completion and checks",
    ]
    assert {p.name: p.read_text() for p in (project / ".simfoundry" / "schemas").iterdir()} == schemas()
    assert ".simfoundry" not in run("new", "b.scene.yaml").out
    (project / "schemas").mkdir()
    (project / "schemas" / "scene.schema.json").write_text(schemas()["scene.schema.json"])
    (project / "deep" / "er").mkdir(parents=True)
    line = MODELINE.match(made("deep/er/c.scene.yaml").read_text())
    assert line is not None and line[1] == "../../schemas/scene.schema.json#/$defs/Editor"


def test_the_next_commands_are_said() -> None:
    assert run("new", "a.scene.yaml").out.splitlines()[-4:] == [
        "next:",
        "  simfoundry check a.scene.yaml",
        "  simfoundry show a.scene.yaml",
        "  simfoundry studio a.scene.yaml",
    ]
    for step in ("check", "show"):
        assert run(step, "a.scene.yaml").code == 0


def test_nothing_is_overwritten_without_force(project: Path) -> None:
    (project / "a.scene.yaml").write_text("mine")
    done = run("new", "a.scene.yaml")
    assert done.code == 2 and "a.scene.yaml already exists; use --force to replace it" in done.err
    assert (project / "a.scene.yaml").read_text() == "mine" and not (project / ".simfoundry").exists()
    assert run("new", "a.scene.yaml", "--force").code == 0
    assert_clean(Path("a.scene.yaml"))


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (["desk"], "the kind of `desk` is unclear"),
        (["scene", "a.task.yaml"], "`a.task.yaml` is not the name of a scene"),
        (["table", "a.scene.yaml"], "the kinds are scene, task, asset, capture, cousins, policy"),
        (["a.task.yaml"], "contains no scene"),
        (["a.cousins.yaml"], "contains no scene"),
        (["a.scene.yaml", "--name", "My Desk"], "`My Desk` is not a valid name"),
        (["123.scene.yaml"], "no name can be derived from `123`"),
        (["a.scene.yaml", "--from", "simfoundry.yaml"], "`--from` is for tasks and recipes"),
        (["a.task.yaml", "--from", "nowhere.scene.yaml"], "does not exist"),
    ],
)
def test_what_cannot_be_made_is_said_in_a_sentence(args: list[str], words: str, project: Path) -> None:
    done = run("new", *args)
    assert done.code == 2 and words in done.err and "Traceback" not in done.err
    assert [p.name for p in project.iterdir()] == ["simfoundry.yaml"]


def test_a_kind_alone_asks_for_a_name() -> None:
    done = run("new", "scene")
    assert (done.code, done.out) == (2, "")
    assert "`new scene desk` creates desk.scene.yaml" in done.err


def test_a_task_is_about_things_that_can_be_put_on_one_another(project: Path) -> None:
    (project / "a.scene.yaml").write_text(
        "simfoundry: scene/1\nname: a\nobjects:\n"
        "  desk: {fixed: true, shape: {box: [1, 1, 0.1]}, density: 600, pose: {xyz: [0.4, 0, -0.05]}}\n"
        "  tray: {shape: {box: [0.3, 0.2, 0.01]}, mass: 0.4, place: {on: desk, xy: [0.4, 0.2]}}\n"
        "  ball: {shape: {sphere: 0.02}, mass: 0.1, place: {on: tray}}\n"
        "  mug: {shape: {cylinder: {radius: 0.04, height: 0.1}}, mass: 0.3, place: {on: desk, xy: [0.4, -0.2]}}\n"
    )
    task = load(made("a.task.yaml")).spec
    assert isinstance(task, TaskSpec)
    assert task.instruction == "Put the mug on the tray."


def test_a_task_without_regions_shows_how_to_write_one(project: Path) -> None:
    (project / "a.scene.yaml").write_text(
        "simfoundry: scene/1\nname: a\nobjects:\n"
        "  desk: {fixed: true, shape: {box: [1, 1, 0.1]}, density: 600, pose: {xyz: [0.4, 0, -0.05]}}\n"
        "  cup: {shape: {box: [0.05, 0.05, 0.1]}, mass: 0.3, place: {on: desk, local_xy: [0.1, 0]}}\n"
    )
    path = made("a.task.yaml")
    text = path.read_text()
    shown = "# objects: {cup: {x: [0.4, 0.5], y: [-0.05, 0.05], yaw_deg: [-180, 180]}}"
    assert shown in text
    path.write_text(text.replace(shown, shown.removeprefix("# ")))
    task = load(path).spec
    assert isinstance(task, TaskSpec) and list(task.reset.objects) == ["cup"]
    assert "= its scene is `a.scene.yaml`" in run("show", path).err


def test_an_asset_calls_its_joint_as_what_it_moves() -> None:
    asset = load(made("a.asset.yaml")).spec
    assert isinstance(asset, AssetSpec)
    assert {name: joint.child for name, joint in asset.joints.items()} == {"drawer": "drawer"}


@pytest.mark.parametrize("push", [(0.0, 1.0), (0.0, -1.0), (-1.0, 0.0)], ids=["left", "right", "back"])
def test_what_lies_in_the_drawer_of_a_new_asset_stays_in_it(push: tuple[float, float], project: Path) -> None:
    """A ball that is pushed against a side of the drawer while that is pulled open in MuJoCo, and afterwards."""
    made("asset", "cabinet.asset.yaml")
    (project / "room.scene.yaml").write_text(
        "simfoundry: scene/1\nname: room\nmaterials: {rubber: {density: 900}}\nobjects:\n"
        "  cabinet: {fixed: true, asset: cabinet.asset.yaml}\n"
        "  ball: {shape: {sphere: 0.02}, material: rubber, pose: {xyz: [0.01, 0, 0.061]}}\n"
    )
    scene = lower_file(project / "room.scene.yaml")
    judge = Judge(scene)
    with MujocoWorld(scene) as world:
        slide, ball = world.model.joint("cabinet.drawer"), world.model.body("ball")
        for _ in range(round(1.5 / world.timestep)):
            world.data.qfrc_applied[slide.dofadr[0]] = 3.0  # N: open within half a second, then held at the end
            world.data.xfrc_applied[ball.id, :2] = 0.15 * np.array(push)  # N, half of what the ball weighs
            world.step()
        world.data.xfrc_applied[ball.id] = 0.0
        world.step(round(0.5 / world.timestep))
        state = world.state()
    assert judge("Open(cabinet.drawer)", state).value
    inside = judge("Inside(ball, cabinet.drawer)", SceneState.of(state.poses, state.joints))
    assert inside.value, inside.why
    assert state.poses["ball"].p[2] > 0.04


def test_a_source_with_errors_is_shown(project: Path) -> None:
    (project / "bad.scene.yaml").write_text("simfoundry: scene/1\nname: bad\nobjets: {}\n")
    done = run("new", "a.task.yaml", "--from", "bad.scene.yaml")
    assert done.code == 2
    done.one_line("bad.scene.yaml:3:1", "SF101", "`objets`")
    made("fine.scene.yaml")
    assert "a task can only extend another task" in run("new", "a.task.yaml", "--extends", "fine.scene.yaml").err
    assert "contains several documents" in run("new", "a.task.yaml").err


def test_odd_paths_stay_readable() -> None:
    made("My desk: #1.scene.yaml")
    path = made("b.scene.yaml", "--extends", "My desk: #1.scene.yaml")
    assert_clean(path)
    assert load(Path("My desk: #1.scene.yaml")).spec is not None
    assert "\nname: my_desk_1\n" in Path("My desk: #1.scene.yaml").read_text()
